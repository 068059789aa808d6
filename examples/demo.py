"""The whole path on made-up data: fit → export → serve → POST /register → report."""

from __future__ import annotations

import json
import math
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console
from rich.table import Table

from model.cloud_file import write_points
from model.se3 import rotation_angle
from training.data.motion import Motion
from training.data.pairs import RegistrationPair, pair_of_shape
from training.data.perturbation import Perturbation
from training.data.procedural import ProceduralShapes

ROOT = Path(__file__).resolve().parent.parent
OUT = ROOT / "demo"
CONFIG = ROOT / "configs" / "quickstart.yaml"
# Far from every seed that the training uses: a shape it has never seen.
UNSEEN_SEED = 20_241_003

# Waiting threads would take the cores from those that work.
ENVIRONMENT = {"OMP_WAIT_POLICY": "passive", **os.environ}
WRONG_ANGLE_DEG = 5.0

console = Console(highlight=False, soft_wrap=True)


def main() -> int:
    """Run every step and say where the results are; 1 if the pose is wrong."""
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir()
    console.rule("1  fit: an encoder from random weights, without labels")
    started = time.monotonic()
    run("fit", "-c", str(CONFIG), "--trainer.default_root_dir", str(OUT / "training"))
    console.print(f"Fitted in {time.monotonic() - started:.0f} seconds.")

    console.rule("2  export: weights and their description")
    checkpoint = max((OUT / "training").rglob("last.ckpt"), key=lambda path: path.stat().st_mtime)
    run("export", str(checkpoint), str(OUT / "artifact"))

    console.rule("3  serve, and POST /register a pair of a shape it has never seen")
    pair = unseen_pair()
    with service(OUT / "artifact") as address:
        answer = post(address, pair)
    angle = show(answer, pair)

    console.rule("4  the same pair on the command line, with a report")
    source, target = OUT / "source.ply", OUT / "target.ply"
    write_points(source, pair.source.double().numpy())
    write_points(target, pair.target.double().numpy())
    run(
        "register", str(source), str(target), "--artifact", str(OUT / "artifact"),
        "--out", str(OUT / "aligned.ply"), "--report", str(OUT / "report.html"),
    )  # fmt: skip

    console.rule("Done")
    verdict = "right" if angle < WRONG_ANGLE_DEG else "WRONG"
    console.print(f"The pose is {verdict}: {angle:.2f}° from the truth.")
    console.print(f"Report:        {OUT / 'report.html'}")
    console.print(f"Aligned cloud: {OUT / 'aligned.ply'}")
    console.print(f"Artifact:      {OUT / 'artifact'}")
    return 0 if angle < WRONG_ANGLE_DEG else 1


def run(*arguments: str) -> None:
    """Run an ``equivalign`` command as a user would."""
    command = [str(Path(sys.executable).with_name("equivalign")), *arguments]
    console.print(f"$ equivalign {' '.join(arguments)}", style="dim", markup=False)
    subprocess.run(command, check=True, cwd=ROOT, env=ENVIRONMENT)


def unseen_pair() -> RegistrationPair:
    """Two noisy, cropped, independent samples of an unseen shape, turned by up to 180°."""
    generator = torch.Generator().manual_seed(UNSEEN_SEED)
    shape = ProceduralShapes(seed=UNSEEN_SEED)[0]
    perturbation = Perturbation(
        sigma=(0.005, 0.005),
        crop_share=(0.1, 0.1),
        target_points=(1024, 1024),
        source_points=(900, 900),
    )
    pair = pair_of_shape(shape, perturbation, generator)
    return pair.moved(Motion(rotation="haar", max_translation=0.5).draw(generator))


@contextmanager
def service(artifact: Path) -> Iterator[str]:
    """``equivalign serve`` on a free port, until the block ends; its log is in a file."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    address = f"http://127.0.0.1:{port}"
    command = [str(Path(sys.executable).with_name("equivalign")), "serve"]
    command += ["--artifact", str(artifact), "--port", str(port)]
    with (OUT / "service.log").open("w") as log:
        process = subprocess.Popen(command, cwd=ROOT, env=ENVIRONMENT, stdout=log, stderr=log)
    try:
        wait_until_ready(address, process)
        yield address
    finally:
        process.terminate()
        process.wait(timeout=30)


def wait_until_ready(address: str, process: subprocess.Popen[bytes]) -> None:
    """Poll ``/readyz``."""
    for _ in range(1800):
        try:
            urllib.request.urlopen(f"{address}/readyz", timeout=5).close()
        except (urllib.error.URLError, ConnectionError):
            if process.poll() is not None:
                break
            time.sleep(0.1)
        else:
            return
    raise SystemExit(f"the service didn't start; see {OUT / 'service.log'}")


def post(address: str, pair: RegistrationPair) -> dict[str, Any]:
    """``POST /register`` with JSON."""
    document = {
        "source": {"points": pair.source.double().tolist()},
        "target": {"points": pair.target.double().tolist()},
        "options": {"max_rotation_deg": 180, "seed": 0},
    }
    request = urllib.request.Request(
        f"{address}/register",
        json.dumps(document).encode(),
        {"Content-Type": "application/json"},
    )
    with urllib.request.urlopen(request, timeout=120) as response:
        answer: dict[str, Any] = json.load(response)
    return answer


def show(answer: dict[str, Any], pair: RegistrationPair) -> float:
    """Print pose, true error and diagnostics; the rotation's error in degrees."""
    T, T_true = np.array(answer["T_target_source"]), pair.T_target_source.double().numpy()
    R, R_true = torch.from_numpy(T[:3, :3]), torch.from_numpy(T_true[:3, :3])
    angle = math.degrees(rotation_angle(R, R_true).item())
    shift = float(np.linalg.norm(T[:3, 3] - T_true[:3, 3]))
    diagnostics = answer["diagnostics"]
    table = Table("quantity", "value", title="POST /register answered")
    table.add_row("T_target_source", "\n".join(" ".join(f"{v: .4f}" for v in row) for row in T))
    table.add_row("true rotation error", f"{angle:.3f}°")
    table.add_row("true translation error", f"{shift:.4f} of the shape's radius")
    for name in ("similarity", "rkhs_distance", "overlap_source", "overlap_target", "converged"):
        value = diagnostics[name]
        table.add_row(name, f"{value:.3f}" if isinstance(value, float) else str(value))
    table.add_row("seconds", f"{diagnostics['seconds']['total']:.2f}")
    console.print(table)
    for warning in diagnostics["warnings"]:
        console.print(f"Warning: {warning}", style="yellow", markup=False)
    return angle


if __name__ == "__main__":
    raise SystemExit(main())
