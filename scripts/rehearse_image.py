"""Builds the image without Docker: does the Dockerfile's steps in chroots, and serves from them.

Needs root, debootstrap and the network. Each stage gets a root directory of its own; the Debian
that debootstrap makes, with Debian's Python, stands in for the ``python:…-slim`` images. At the
end the service runs as the image's user, with the root directory read-only, and registers the
example of its own API description; the SBOM is written beside.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
SUITE = "bookworm"  # its Python is the Dockerfile's 3.11
PACKAGES = "ca-certificates,python3,python3-pip,python3-venv"
NOT_SERVING = {"lightning", "pytorch-lightning", "tensorboard", "mypy", "ruff", "schemathesis"}
# What a build argument, a proxy or an own index is to Docker.
PASSED_ON = re.compile(r"PIP_\w+|\w+_proxy|SSL_CERT_\w+", re.IGNORECASE)


@dataclass(slots=True)
class Stage:
    """One stage of the Dockerfile.

    Attributes:
        name: after AS.
        root: its root directory.
        variables: set by ENV.
        arguments: set by ARG.
        user: of the command.
        folder: the working directory.
        command: by CMD.
        health: by HEALTHCHECK.
    """

    name: str
    root: Path
    variables: dict[str, str] = field(default_factory=dict)
    arguments: dict[str, str] = field(default_factory=dict)
    user: str = "0"
    folder: str = "/"
    command: list[str] = field(default_factory=list)
    health: list[str] = field(default_factory=list)

    def environment(self) -> dict[str, str]:
        """What a step sees."""
        passed = {name: value for name, value in os.environ.items() if PASSED_ON.fullmatch(name)}
        path = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"}
        return {**path, "PIP_QUIET": "1", **passed, **self.arguments, **self.variables}


def main() -> int:
    """Build every stage, serve from the last one, register, and say what was measured."""
    given = _arguments()
    given.place.mkdir(parents=True, exist_ok=True)
    base = _base(given.place / "base")
    stages: dict[str, Stage] = {}
    for instruction, rest in instructions((PROJECT / "Dockerfile").read_text(encoding="utf-8")):
        _step(instruction, rest, stages, base, given)
    service = stages["service"]
    sbom = json.loads((stages["sbom"].root / "sbom.json").read_text(encoding="utf-8"))
    held = {component["name"].lower() for component in sbom["components"]}
    print(f"SBOM: {len(held)} components in {stages['sbom'].root / 'sbom.json'}")
    unwanted = held & {
        "lightning",
        "pytorch-lightning",
        "tensorboard",
        "mypy",
        "ruff",
        "schemathesis",
    }
    if unwanted:
        print(f"The image would hold more than serving needs: {unwanted}", file=sys.stderr)
        return 1
    _serve(service, given)
    print("The image's steps work.")
    return 0


def instructions(dockerfile: str) -> Iterator[tuple[str, str]]:
    """The instructions of a Dockerfile with their arguments, continued lines joined."""
    lines = [line for line in dockerfile.splitlines() if not line.lstrip().startswith("#")]
    for line in re.sub(r"\\\n", " ", "\n".join(lines)).splitlines():
        if line.strip():
            instruction, _, rest = line.strip().partition(" ")
            yield instruction.upper(), rest.strip()


def _arguments() -> Namespace:
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--place", type=Path, default=Path("/var/tmp/equivalign-image"))
    parser.add_argument("--port", type=int, default=18000)
    parser.add_argument(
        "--bind", action="append", default=[], metavar="PATH",
        help="show this path of the machine in the chroots, such as a local index of packages",
    )  # fmt: skip
    parser.add_argument("--build-arg", action="append", default=[], metavar="NAME=VALUE")
    return parser.parse_args()


def _base(root: Path) -> Path:
    """Debian with Python, made once."""
    if not (root / "made").exists():
        shutil.rmtree(root, ignore_errors=True)
        command = ["debootstrap", "--variant=minbase", f"--include={PACKAGES}", SUITE, str(root)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        (root / "usr/local/bin/python").symlink_to("/usr/bin/python3")
        (root / "made").touch()
    return root


def _step(
    instruction: str, rest: str, stages: dict[str, Stage], base: Path, given: Namespace
) -> None:
    if instruction == "FROM":
        _begin(rest, stages, base, given)
        return
    if not stages:  # an ARG before the first FROM chooses the base, which is Debian here
        return
    stage = next(reversed(stages.values()))
    match instruction:
        case "ARG":
            name, _, default = rest.partition("=")
            chosen = dict(argument.split("=", 1) for argument in given.build_arg)
            stage.arguments[name] = chosen.get(name, default.strip('"'))
        case "ENV":
            for word in shlex.split(rest):
                name, _, value = word.partition("=")
                stage.variables[name] = value.replace("$PATH", stage.environment()["PATH"])
        case "WORKDIR":
            stage.folder = rest
            (stage.root / rest.lstrip("/")).mkdir(parents=True, exist_ok=True)
        case "USER":
            stage.user = rest
        case "COPY":
            _copy(shlex.split(rest), stage, stages)
        case "RUN":
            print(f"[{stage.name}] {rest[:100]}", flush=True)
            started = time.monotonic()
            _run(stage, ["sh", "-c", rest], given.bind)
            print(f"[{stage.name}] … {time.monotonic() - started:.0f} s", flush=True)
        case "CMD":
            stage.command = json.loads(rest)
        case "HEALTHCHECK":
            stage.health = json.loads(rest.partition("CMD ")[2])
        case "EXPOSE" | "STOPSIGNAL":
            pass
        case _:
            raise SystemExit(f"this rehearsal doesn't know {instruction}")


def _begin(rest: str, stages: dict[str, Stage], base: Path, given: Namespace) -> None:
    source, _, name = rest.partition(" AS ")
    root = given.place / name
    shutil.rmtree(root, ignore_errors=True)
    stage = Stage(name, root)
    if source == "scratch":
        root.mkdir()
    else:
        origin = stages.get(source)
        command = ["cp", "-a", "--reflink=auto", str(origin.root if origin else base), str(root)]
        subprocess.run(command, check=True)
        if origin is not None:
            stage.variables, stage.folder = dict(origin.variables), origin.folder
    stages[name] = stage


def _copy(words: list[str], stage: Stage, stages: dict[str, Stage]) -> None:
    origin = PROJECT
    if words[0].startswith("--from="):
        origin = stages[words.pop(0).removeprefix("--from=")].root
    *sources, into = words
    target = stage.root / (into if into.startswith("/") else f"{stage.folder}/{into}").lstrip("/")
    for source in sources:
        path = origin / source.lstrip("/")
        if path.is_dir():
            unwanted = (
                None if origin != PROJECT else shutil.ignore_patterns("__pycache__", "*.py[co]")
            )
            shutil.copytree(path, target, symlinks=True, ignore=unwanted, dirs_exist_ok=True)
        else:
            place = target / path.name if into.endswith("/") else target
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(path, place)


@contextmanager
def _mounted(root: Path, binds: list[str], *, read_only: bool = False) -> Iterator[Path]:
    """The root with /proc, /dev and the name server, and unmounted after."""
    with ExitStack() as stack:

        def mount(*words: str) -> None:
            subprocess.run(["mount", *words], check=True)
            stack.callback(subprocess.run, ["umount", "--lazy", words[-1]], check=True)

        if read_only:
            mount("--bind", str(root), str(root))
            subprocess.run(["mount", "-o", "remount,ro,bind", str(root)], check=True)
            mount("-t", "tmpfs", "-o", "mode=1777", "tmpfs", str(root / "tmp"))
        else:
            shutil.copy("/etc/resolv.conf", root / "etc/resolv.conf")
            for path in map(Path, binds):
                inside = root / str(path).lstrip("/")
                if path.is_dir():
                    inside.mkdir(parents=True, exist_ok=True)
                else:
                    inside.parent.mkdir(parents=True, exist_ok=True)
                    inside.touch()
                mount("--bind", str(path), str(inside))
        mount("-t", "proc", "proc", str(root / "proc"))
        mount("--bind", "/dev", str(root / "dev"))
        yield root


def _run(stage: Stage, command: list[str], binds: list[str]) -> None:
    with _mounted(stage.root, binds) as root:
        words = ["chroot", str(root), "sh", "-c", f'cd {shlex.quote(stage.folder)} && exec "$@"']
        subprocess.run([*words, "sh", *command], check=True, env=stage.environment())


def _serve(stage: Stage, given: Namespace) -> None:
    """Run the image's command as its user on a read-only root, and register a pair."""
    variables = stage.environment() | {"EQUIVALIGN_PORT": str(given.port)}
    address = f"http://127.0.0.1:{given.port}"
    with _mounted(stage.root, [], read_only=True) as root:
        become = ["chroot", f"--userspec={stage.user}:{stage.user}", str(root)]
        move = ["sh", "-c", f'cd {stage.folder} && exec "$@"', "sh"]
        started = time.monotonic()
        process = subprocess.Popen([*become, *move, *stage.command], env=variables)
        try:
            _wait_until_ready(address, process)
            print(f"Ready after {time.monotonic() - started:.1f} s as user {stage.user}.")
            subprocess.run([*become, *stage.health], check=True, env=variables)
            print(*_register_example(address), sep="\n")
        finally:
            process.send_signal(signal.SIGTERM)
            ended = process.wait(120)
    if ended not in (-signal.SIGTERM, 128 + signal.SIGTERM):
        raise SystemExit(f"the service ended with {ended} after SIGTERM")
    size = subprocess.run(
        ["du", "-sm", str(stage.root)], capture_output=True, text=True, check=True
    )
    print(f"The image's files take {size.stdout.split()[0]} MiB.")


def _wait_until_ready(address: str, process: subprocess.Popen[bytes]) -> None:
    for _ in range(1200):
        if process.poll() is not None:
            raise SystemExit(f"the service ended with {process.returncode}")
        try:
            urllib.request.urlopen(f"{address}/readyz", timeout=5).close()
            return
        except (urllib.error.URLError, ConnectionError):
            time.sleep(0.1)
    raise SystemExit("the service isn't ready after two minutes")


def _register_example(address: str) -> list[list[float]]:
    with urllib.request.urlopen(f"{address}/openapi.json") as answer:
        body = json.load(answer)["paths"]["/register"]["post"]["requestBody"]
    example = json.dumps(body["content"]["application/json"]["example"]).encode()
    request = urllib.request.Request(
        f"{address}/register", example, {"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request, timeout=60) as answer:
        result = json.load(answer)
    assert result["diagnostics"]["overlap_source"] > 0.9, result["diagnostics"]
    found: list[list[float]] = result["T_target_source"]
    return found


if __name__ == "__main__":
    sys.exit(main())
