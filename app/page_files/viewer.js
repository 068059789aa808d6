// Clouds and arrows in 3D, drawn by WebGL; turned by mouse, touch and keys.

const POINT_VERTEX = `
attribute vec3 position; uniform mat4 view, model; uniform float size;
void main() { gl_Position = view * model * vec4(position, 1.0); gl_PointSize = size; }`;
const POINT_FRAGMENT = `
precision mediump float; uniform vec3 colour;
void main() {
  vec2 p = gl_PointCoord * 2.0 - 1.0; float r = dot(p, p); if (r > 1.0) discard;
  gl_FragColor = vec4(colour * (1.0 - 0.35 * r), 1.0);
}`;
const SOLID_VERTEX = `
attribute vec3 position, normal; uniform mat4 view, model; uniform mat3 camera; varying float light;
void main() {
  gl_Position = view * model * vec4(position, 1.0);
  light = 0.55 + 0.45 * abs((camera * mat3(model) * normal).z);
}`;
const SOLID_FRAGMENT = `
precision mediump float; uniform vec3 colour; varying float light;
void main() { gl_FragColor = vec4(colour * light, 1.0); }`;

const SIDES = 8;
export const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

export class Viewer {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    this.layers = new Map();
    this.pointSize = 5;
    this.centre = [0, 0, 0];
    this.radius = 1;
    this.resetView();
    if (!this.gl) return;
    this.points = program(this.gl, POINT_VERTEX, POINT_FRAGMENT);
    this.solid = program(this.gl, SOLID_VERTEX, SOLID_FRAGMENT);
    this.gl.enable(this.gl.DEPTH_TEST);
    listen(this);
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  get works() { return Boolean(this.gl); }

  resetView() {
    this.turn = rotationAbout([1, 0, 0], -1.15, rotationAbout([0, 0, 1], -0.6, identity3()));
    this.zoom = 1;
    this.pan = [0, 0];
  }

  // points: Float32Array of x, y, z; colour: a function, for it follows the theme.
  setPoints(name, points, colour) {
    this.layers.set(name, {
      kind: "points", data: buffer(this.gl, points), count: points.length / 3, colour,
      model: IDENTITY, visible: true,
    });
  }

  setArrows(name, tails, vectors, length, colour) {
    const mesh = arrowMesh(tails, vectors, length);
    this.layers.set(name, {
      kind: "solid", data: buffer(this.gl, mesh), count: mesh.length / 6, colour,
      model: IDENTITY, visible: true,
    });
  }

  remove(name) {
    const layer = this.layers.get(name);
    if (layer) this.gl.deleteBuffer(layer.data);
    this.layers.delete(name);
  }

  layer(name) { return this.layers.get(name); }

  frame(centre, radius) {
    this.centre = centre;
    this.radius = radius || 1;
  }

  draw() {
    if (!this.gl || this.pending) return;
    this.pending = true;
    requestAnimationFrame(() => { this.pending = false; this.drawNow(); });
  }

  drawNow() {
    const gl = this.gl;
    const scale = window.devicePixelRatio || 1;
    const width = Math.round(this.canvas.clientWidth * scale);
    const height = Math.round(this.canvas.clientHeight * scale);
    if (this.canvas.width !== width || this.canvas.height !== height) {
      this.canvas.width = width;
      this.canvas.height = height;
    }
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const view = this.viewMatrix(width / height);
    for (const layer of this.layers.values()) {
      if (!layer.visible || !layer.count) continue;
      const used = layer.kind === "points" ? this.points : this.solid;
      gl.useProgram(used);
      gl.bindBuffer(gl.ARRAY_BUFFER, layer.data);
      const stride = layer.kind === "points" ? 12 : 24;
      attribute(gl, used, "position", stride, 0);
      if (layer.kind === "solid") {
        attribute(gl, used, "normal", stride, 12);
        gl.uniformMatrix3fv(gl.getUniformLocation(used, "camera"), false, transposed3(this.turn));
      } else {
        gl.uniform1f(gl.getUniformLocation(used, "size"), this.pointSize * scale);
      }
      gl.uniformMatrix4fv(gl.getUniformLocation(used, "view"), false, view);
      gl.uniformMatrix4fv(gl.getUniformLocation(used, "model"), false, columns(layer.model));
      gl.uniform3fv(gl.getUniformLocation(used, "colour"), layer.colour());
      gl.drawArrays(layer.kind === "points" ? gl.POINTS : gl.TRIANGLES, 0, layer.count);
    }
  }

  // Column-major: turn about the centre, then a mild perspective.
  viewMatrix(aspect) {
    const distance = 3.2 / this.zoom;
    const s = 1 / this.radius;
    const R = this.turn;
    const t = [0, 1, 2].map((i) => -s * (R[3 * i] * this.centre[0] + R[3 * i + 1] * this.centre[1] + R[3 * i + 2] * this.centre[2]));
    t[0] += this.pan[0];
    t[1] += this.pan[1];
    t[2] -= distance;
    const focal = 2.4;
    const fx = aspect >= 1 ? focal / aspect : focal;
    const fy = aspect >= 1 ? focal : focal * aspect;
    const near = Math.max(0.02, distance - 4);
    const far = distance + 4;
    const a = (far + near) / (near - far);
    const b = (2 * far * near) / (near - far);
    const rows = [
      [fx * s * R[0], fx * s * R[1], fx * s * R[2], fx * t[0]],
      [fy * s * R[3], fy * s * R[4], fy * s * R[5], fy * t[1]],
      [a * s * R[6], a * s * R[7], a * s * R[8], a * t[2] + b],
      [-s * R[6], -s * R[7], -s * R[8], -t[2]],
    ];
    return new Float32Array([0, 1, 2, 3].flatMap((c) => rows.map((row) => row[c])));
  }

  rotate(dx, dy) {
    this.turn = rotationAbout([1, 0, 0], dy, rotationAbout([0, 1, 0], dx, this.turn));
    this.draw();
  }

  zoomBy(factor) {
    this.zoom = Math.min(20, Math.max(0.2, this.zoom * factor));
    this.draw();
  }
}

function listen(viewer) {
  const { canvas } = viewer;
  const fingers = new Map();
  let spread = 0;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    spread = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    const [x, y] = fingers.get(event.pointerId);
    const [dx, dy] = [event.clientX - x, event.clientY - y];
    fingers.set(event.pointerId, [event.clientX, event.clientY]);
    if (fingers.size === 2) {
      const [[ax, ay], [bx, by]] = [...fingers.values()];
      const now = Math.hypot(ax - bx, ay - by);
      if (spread) viewer.zoomBy(now / spread);
      spread = now;
    } else if (event.shiftKey || event.buttons === 2) {
      viewer.pan[0] += (2 * dx) / canvas.clientHeight;
      viewer.pan[1] -= (2 * dy) / canvas.clientHeight;
      viewer.draw();
    } else {
      viewer.rotate(dx / 150, dy / 150);
    }
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => { fingers.delete(event.pointerId); spread = 0; });
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    viewer.zoomBy(Math.exp(-event.deltaY / 600));
  }, { passive: false });
  const keys = {
    ArrowLeft: () => viewer.rotate(-0.12, 0), ArrowRight: () => viewer.rotate(0.12, 0),
    ArrowUp: () => viewer.rotate(0, -0.12), ArrowDown: () => viewer.rotate(0, 0.12),
    "+": () => viewer.zoomBy(1.15), "=": () => viewer.zoomBy(1.15), "-": () => viewer.zoomBy(1 / 1.15),
    0: () => { viewer.resetView(); viewer.draw(); },
  };
  canvas.addEventListener("keydown", (event) => {
    if (!(event.key in keys) || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
  });
}

function program(gl, vertex, fragment) {
  const made = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(made, shader);
  }
  gl.linkProgram(made);
  return made;
}

function buffer(gl, data) {
  const made = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, made);
  gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
  return made;
}

function attribute(gl, used, name, stride, offset) {
  const place = gl.getAttribLocation(used, name);
  gl.enableVertexAttribArray(place);
  gl.vertexAttribPointer(place, 3, gl.FLOAT, false, stride, offset);
}

// Shafts and tips of arrows as triangles: x, y, z and a normal for every corner.
function arrowMesh(tails, vectors, length) {
  const corners = [];
  tails.forEach((tail, k) => {
    const size = Math.hypot(...vectors[k]);
    if (size < 1e-9) return;
    const along = vectors[k].map((v) => v / size);
    const side = normalised(cross(along, Math.abs(along[0]) < 0.8 ? [1, 0, 0] : [0, 1, 0]));
    const other = cross(along, side);
    const whole = length * size;
    const head = Math.min(0.3 * length, 0.5 * whole);
    const thin = 0.022 * length;
    const at = (distance, radius, angle) => tail.map((v, i) =>
      v + distance * along[i] + radius * (Math.cos(angle) * side[i] + Math.sin(angle) * other[i]));
    const put = (point, angle) => corners.push(...point,
      ...[0, 1, 2].map((i) => Math.cos(angle) * side[i] + Math.sin(angle) * other[i]));
    for (let n = 0; n < SIDES; n += 1) {
      const [a, b] = [n, n + 1].map((m) => (2 * Math.PI * m) / SIDES);
      for (const [d, angle] of [[0, a], [0, b], [whole - head, a], [0, b], [whole - head, b], [whole - head, a]]) {
        put(at(d, thin, angle), angle);
      }
      put(at(whole - head, 3.5 * thin, a), a);
      put(at(whole - head, 3.5 * thin, b), b);
      put(at(whole, 0, a), a);
    }
  });
  return new Float32Array(corners);
}

function cross(a, b) {
  return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
}
function normalised(a) { const n = Math.hypot(...a); return a.map((v) => v / n); }
function identity3() { return [1, 0, 0, 0, 1, 0, 0, 0, 1]; }
// Row-major in, column-major out, and for 3×3 too.
function columns(m) { return new Float32Array([0, 1, 2, 3].flatMap((c) => [0, 1, 2, 3].map((r) => m[4 * r + c]))); }
function transposed3(m) { return new Float32Array([0, 1, 2].flatMap((c) => [0, 1, 2].map((r) => m[3 * r + c]))); }

function multiplied3(a, b) {
  return [0, 1, 2].flatMap((r) => [0, 1, 2].map((c) =>
    a[3 * r] * b[c] + a[3 * r + 1] * b[3 + c] + a[3 * r + 2] * b[6 + c]));
}

// Rodrigues' formula, row-major; the rotation comes after `before`.
export function rotationAbout(axis, angle, before = identity3()) {
  const [x, y, z] = axis;
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const v = 1 - c;
  return multiplied3([
    c + x * x * v, x * y * v - z * s, x * z * v + y * s,
    y * x * v + z * s, c + y * y * v, y * z * v - x * s,
    z * x * v - y * s, z * y * v + x * s, c + z * z * v,
  ], before);
}
