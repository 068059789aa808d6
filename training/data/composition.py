"""Object-like assemblies of solids: a body, limbs attached to it, some repeated, some not."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from training.data.profile import FloatArray, Profile, rectangle, regular, star, strip
from training.data.solid import Part, Pipe, Prism, Revolution, Solid, sample_triangles

Random = np.random.Generator
# An affine map p → A p + offset that copies a part somewhere else.
Placement = tuple[FloatArray, FloatArray]

_MOST_PARTS = 14


def random_solid(random: Random) -> Solid:
    """One body in its own frame, of any family."""
    family = _FAMILIES[random.choice(len(_FAMILIES), p=_FAMILY_SHARES)]
    return family(random)


def random_assembly(random: Random) -> list[Part]:
    """The parts of one object: a body, groups of limbs, then parts that break the symmetry."""
    parts = [Part(random_solid(random), np.diag(_body_size(random)), np.zeros(3))]
    for _ in range(int(random.integers(1, 5))):
        limb = _attached(parts, random)
        copies = [limb.moved(A, offset) for A, offset in _repetition(limb, random)]
        if len(parts) + len(copies) <= _MOST_PARTS:
            parts.extend(copies)
    for _ in range(int(random.integers(1, 3))):
        parts.append(_attached(parts, random))
    return _posed(parts, random)


def _posed(parts: list[Part], random: Random) -> list[Part]:
    """The object stretched along its axes, then turned anywhere."""
    stretch = np.diag(np.exp(random.uniform(-0.35, 0.35, 3)))
    A = _random_rotation(random) @ stretch
    return [part.moved(A, np.zeros(3)) for part in parts]


def _body_size(random: Random) -> FloatArray:
    """Half-extents of a block, a plate or a bar."""
    size = np.exp(random.uniform(math.log(0.35), 0.0, 3))
    kind = random.random()
    if kind < 0.25:
        size[random.integers(3)] *= 0.2
    elif kind < 0.4:
        size[random.permutation(3)[:2]] *= 0.3
    return size


def _limb_size(random: Random) -> FloatArray:
    """Half-extents of a limb, its length along z: bars and plates more often than blocks."""
    length = math.exp(random.uniform(math.log(0.12), math.log(0.8)))
    kind = random.random()
    if kind < 0.4:
        across = random.uniform(0.03, 0.12, 2)
    elif kind < 0.7:
        across = np.array([random.uniform(0.03, 0.08), random.uniform(0.15, 0.7)])
    else:
        across = length * np.exp(random.uniform(-0.7, 0.5, 2))
    return np.array([*random.permutation(across), length])


def _attached(parts: list[Part], random: Random) -> Part:
    """A new part whose lower end sits in the surface of one of the others."""
    host = parts[0] if random.random() < 0.6 else parts[random.integers(len(parts))]
    point, normal, _ = sample_triangles(host.triangles, 1, random)
    size = _limb_size(random)
    direction = _limb_direction(normal[0], random)
    reach = size[2] * random.uniform(0.4, 0.95)
    A = _frame_along(direction, random) @ np.diag(size)
    return Part(random_solid(random), A, point[0] + reach * direction)


def _limb_direction(normal: FloatArray, random: Random) -> FloatArray:
    """Mostly along an axis of the object and outwards, as made things are; else anywhere."""
    kind = random.random()
    if kind < 0.6:
        axis = np.zeros(3)
        i = int(random.integers(3)) if random.random() < 0.4 else int(np.argmax(np.abs(normal)))
        axis[i] = 1.0 if normal[i] >= 0.0 else -1.0
        return axis
    if kind < 0.8:
        return normal
    tilted = normal + 0.8 * random.standard_normal(3)
    unit: FloatArray = tilted / np.linalg.norm(tilted)
    return unit


def _repetition(part: Part, random: Random) -> list[Placement]:
    """Where the copies of a limb stand: alone, mirrored, at four corners, in a ring or in a row."""
    here: Placement = (np.eye(3), np.zeros(3))
    kind = random.random()
    if kind < 0.3:
        return [here]
    if kind < 0.55:
        mirrored = np.eye(3)
        axis = int(random.integers(3))
        mirrored[axis, axis] = -1.0
        return [here, (mirrored, np.zeros(3))]
    if kind < 0.75:
        x, y = random.permutation(3)[:2]
        corners = []
        for signs in ((1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)):
            A = np.eye(3)
            A[x, x], A[y, y] = signs
            corners.append((A, np.zeros(3)))
        return corners
    if kind < 0.88:
        count = int(random.integers(3, 7))
        return [(_turn(2.0 * math.pi * i / count), np.zeros(3)) for i in range(count)]
    count = int(random.integers(2, 6))
    step = np.zeros(3)
    axis = int(random.integers(3))
    step[axis] = -math.copysign(random.uniform(0.15, 0.5), part.offset[axis])
    return [(np.eye(3), i * step) for i in range(count)]


def _turn(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _frame_along(direction: FloatArray, random: Random) -> FloatArray:
    """A rotation that takes z to ``direction``, its x near an axis or, at times, anywhere."""
    helper = np.eye(3)[np.argmin(np.abs(direction))]
    if random.random() < 0.25:
        helper = random.standard_normal(3)
    x = helper - (helper @ direction) * direction
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction], axis=1)


def _random_rotation(random: Random) -> FloatArray:
    """Uniform over SO(3): a normal matrix orthogonalised, its reflections repaired."""
    Q, upper = np.linalg.qr(random.standard_normal((3, 3)))
    Q = Q * np.sign(np.diag(upper))
    if np.linalg.det(Q) < 0.0:
        Q[:, 0] = -Q[:, 0]
    rotation: FloatArray = Q
    return rotation


def _box(random: Random) -> Solid:
    return Prism(rectangle(-1.0, 1.0, -1.0, 1.0))


def _frustum(random: Random) -> Solid:
    """Pyramids, wedge-like blocks and many-cornered posts."""
    corners = int(random.integers(3, 8))
    taper = 0.0 if random.random() < 0.25 else float(random.uniform(0.2, 1.0))
    return Prism(regular(corners), taper)


def _wedge(random: Random) -> Solid:
    """A triangle with a corner anywhere above its base, so usually without any symmetry."""
    top = float(random.uniform(-1.0, 1.0))
    outline = np.array([[-1.0, -1.0], [1.0, -1.0], [top, 1.0]])
    return Prism(Profile(outline, outline, np.array([[0, 1, 2]])))


def _ragged_slab(random: Random) -> Solid:
    """A random, mostly non-convex outline."""
    corners = int(random.integers(5, 13))
    return Prism(star(random.uniform(0.35, 1.0, corners)), float(random.uniform(0.6, 1.0)))


def _section(random: Random) -> Solid:
    """An L, U, Z or S section, as of rails, shelves and seats."""
    a, b = random.uniform(0.4, 1.0, 2)
    lines = (
        [[-a, 1.0], [-a, -b], [1.0, -b]],
        [[-a, 1.0], [-a, -1.0], [a, -1.0], [a, b]],
        [[-1.0, b], [0.0, b], [0.0, -a], [1.0, -a]],
        [[-1.0, -1.0], [-1.0, b], [0.6, b], [0.6, -a], [-0.4, -a]],
    )
    line = np.array(lines[random.integers(len(lines))])
    return Prism(strip(line, float(random.uniform(0.1, 0.35))))


def _curved_wall(random: Random) -> Solid:
    """A bent plate: backrests, shells, mudguards."""
    opening = random.uniform(0.25, 0.8) * 2.0 * math.pi
    angle = np.linspace(-0.5 * opening, 0.5 * opening, 14)
    radius = 1.0 + random.uniform(-0.25, 0.25) * np.linspace(-1.0, 1.0, 14)
    line = 0.85 * radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Prism(strip(line, float(random.uniform(0.06, 0.3))))


def _cylinder(random: Random) -> Solid:
    """A cylinder, a cone or a frustum of one."""
    top = 1.0 if random.random() < 0.5 else float(random.uniform(0.0, 0.9))
    outline = np.array([[0.0, -1.0], [1.0, -1.0], [top, 1.0], [0.0, 1.0]])
    return Revolution(Profile(outline, outline, np.array([[0, 1, 2], [0, 2, 3]])))


def _tube(random: Random) -> Solid:
    """A hollow cylinder."""
    return Revolution(rectangle(float(random.uniform(0.4, 0.9)), 1.0, -1.0, 1.0))


def _ellipsoid(random: Random) -> Solid:
    """A ball, cut flat below in half of the cases; its placement stretches it."""
    lowest = -1.0 if random.random() < 0.5 else float(random.uniform(-0.6, 0.3))
    angle = np.linspace(math.asin(lowest), 0.5 * math.pi, 14)
    arc = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    arc[-1] = (0.0, 1.0)
    outline = np.concatenate([arc, [[0.0, lowest]]])
    return Revolution(Profile(outline, outline, np.empty((0, 3), dtype=np.int64)))


def _torus(random: Random) -> Solid:
    minor = float(random.uniform(0.12, 0.4))
    ring = regular(12, minor).outline + np.array([1.0 - minor, 0.0])
    return Revolution(Profile(ring, ring, np.empty((0, 3), dtype=np.int64)))


def _vessel(random: Random) -> Solid:
    """A bowl or a vase: a curved wall turned about the axis, closed at its foot."""
    height = np.linspace(-0.9, 0.9, 9)
    a, b, phase = random.uniform(0.3, 0.7), random.uniform(0.0, 0.25), random.uniform(0.0, 6.0)
    radius = a + 0.25 * random.uniform(-1.0, 1.0) * height + b * np.sin(2.0 * height + phase)
    wall = np.stack([np.clip(radius, 0.2, 0.95), height], axis=1)
    thickness = float(random.uniform(0.06, 0.15))
    return Revolution(strip(np.concatenate([[[0.0, -0.95]], wall]), thickness), segments=24)


def _bent_pipe(random: Random) -> Solid:
    """A bar along a cubic Bézier curve."""
    control = random.uniform(-1.0, 1.0, (4, 3))
    control[0, 2], control[3, 2] = -1.0, 1.0
    u = np.linspace(0.0, 1.0, 9)[:, None]
    path = (
        (1 - u) ** 3 * control[0]
        + 3 * u * (1 - u) ** 2 * control[1]
        + 3 * u**2 * (1 - u) * control[2]
        + u**3 * control[3]
    )
    return Pipe(path, float(random.uniform(0.06, 0.25)))


_FAMILIES: tuple[Callable[[Random], Solid], ...] = (
    _box,
    _frustum,
    _wedge,
    _ragged_slab,
    _section,
    _curved_wall,
    _cylinder,
    _tube,
    _ellipsoid,
    _torus,
    _vessel,
    _bent_pipe,
)
_FAMILY_SHARES = (0.2, 0.07, 0.08, 0.1, 0.1, 0.08, 0.12, 0.04, 0.08, 0.03, 0.04, 0.06)
