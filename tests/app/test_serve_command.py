"""``equivalign serve``: what stops it at once, and one real process."""

import json
import signal
import socket
import subprocess
import sys
from pathlib import Path

import httpx2
import pytest

from app.api_description import register_example
from app.command_line import main


def test_a_port_in_use_is_one_line(artifact: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        assert main(["serve", "--artifact", str(artifact), "--port", str(port)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("equivalign: port: can't listen there")
    assert error.count("\n") == 1


@pytest.mark.parametrize("damage", ["missing", "description", "weights"])
def test_a_bad_artifact_stops_the_start(
    damage: str, artifact: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken"
    if damage != "missing":
        broken.mkdir()
        for file in artifact.iterdir():
            cut = damage in file.name or (damage, file.suffix) in {
                ("description", ".json"),
                ("weights", ".safetensors"),
            }
            (broken / file.name).write_bytes(file.read_bytes()[: -20 if cut else None])
    assert main(["serve", "--artifact", str(broken), "--port", "0"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("equivalign: ")
    assert error.count("\n") == 1


def test_bad_settings_are_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["serve", "--port", "99999"]) == 2
    assert capsys.readouterr().err.startswith("equivalign: port: ")
    monkeypatch.setenv("EQUIVALIGN_WORKERS", "0")
    assert main(["serve"]) == 2
    assert capsys.readouterr().err.startswith("equivalign: EQUIVALIGN_WORKERS: ")


def test_a_process_serves_until_it_is_told_to_stop(artifact: Path) -> None:
    # A shell that runs this in the background passes SIGINT on as ignored.
    start = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from app.command_line import main; sys.exit(main())"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", start, "serve", "--artifact", artifact, "--port", "0"],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    try:
        serving = json.loads(process.stderr.readline())
        assert serving["event"] == "serving"
        while json.loads(process.stderr.readline())["event"] != "ready":
            pass
        url = f"http://127.0.0.1:{serving['port']}"
        answer = httpx2.post(f"{url}/register", json=register_example(), timeout=60)
        assert answer.status_code == 200
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 130
        events = [json.loads(line) for line in process.stderr]
        assert [event["path"] for event in events if event["event"] == "request"] == ["/register"]
    finally:
        process.kill()
        process.stderr.close()
        process.wait()
