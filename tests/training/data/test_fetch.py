from __future__ import annotations

import hashlib
import io
import stat
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from model.exceptions import InvalidOptionError
from training.data import command
from training.data.command import data_command
from training.data.download import DownloadError, download
from training.data.fetch import Archive, Dataset, eth3d_sequences, fetch
from training.data.unpack import unpack


@dataclass
class Server:
    """Files by path; may cut its answers short, and remembers what it was asked."""

    address: str = ""
    files: dict[str, bytes] = field(default_factory=dict)
    cut_after: list[int] = field(default_factory=list)
    marks: bool = True
    ranges: list[str | None] = field(default_factory=list)


@pytest.fixture
def server() -> Iterator[Server]:
    state = Server()

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked = self.headers["Range"]
            state.ranges.append(asked)
            content = state.files.get(self.path)
            if content is None:
                self.send_error(404)
                return
            mark = f'"{hashlib.sha1(content).hexdigest()}"'
            start = 0
            if asked and self.headers["If-Range"] == mark:
                start = int(asked.removeprefix("bytes=").rstrip("-"))
                if start >= len(content):
                    self.send_error(416)
                    return
            self.send_response(206 if start else 200)
            if start:
                self.send_header(
                    "Content-Range", f"bytes {start}-{len(content) - 1}/{len(content)}"
                )
            if state.marks:
                self.send_header("ETag", mark)
            self.send_header("Content-Length", str(len(content) - start))
            self.end_headers()
            rest = content[start:]
            self.wfile.write(rest[: state.cut_after.pop(0)] if state.cut_after else rest)

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as http:
        state.address = f"http://127.0.0.1:{http.server_port}"
        thread = threading.Thread(target=http.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield state
        http.shutdown()
        thread.join()


def zipped(files: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return stream.getvalue()


def dataset(server: Server, md5: str | None = None, limit: int = 10**6) -> Dataset:
    return Dataset("Set", "Set40", (Archive(f"{server.address}/set.zip", md5),), limit)


def get(server: Server, path: Path) -> list[tuple[int, int | None]]:
    seen: list[tuple[int, int | None]] = []
    download(f"{server.address}/file", path, lambda _, done, total: seen.append((done, total)), "")
    return seen


CONTENT = bytes(range(256)) * 40


def test_a_download_reports_its_progress(server: Server, tmp_path: Path) -> None:
    server.files["/file"] = CONTENT
    seen = get(server, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT
    assert seen[0] == (0, len(CONTENT))
    assert seen[-1] == (len(CONTENT), len(CONTENT))
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    get(server, tmp_path / "file")
    assert len(server.ranges) == 1


def test_a_cut_download_goes_on_where_it_stopped(server: Server, tmp_path: Path) -> None:
    server.files["/file"] = CONTENT
    server.cut_after = [3000, 2000]
    get(server, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT
    assert server.ranges == [None, "bytes=3000-", "bytes=5000-"]


def test_a_part_from_an_earlier_run_is_used_only_of_the_same_file(
    server: Server, tmp_path: Path
) -> None:
    server.files["/file"] = CONTENT
    server.cut_after = [3000, 0, 0, 0, 0, 0, 0]
    with pytest.raises(DownloadError, match="after 3000 of 10240 bytes"):
        get(server, tmp_path / "file")
    server.cut_after = []
    server.files["/file"] = CONTENT[::-1]
    get(server, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT[::-1]
    assert server.ranges[-1] == "bytes=3000-"


def test_without_a_mark_of_the_version_it_starts_over(server: Server, tmp_path: Path) -> None:
    server.files["/file"] = CONTENT
    server.marks = False
    server.cut_after = [3000]
    get(server, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT
    assert server.ranges == [None, None]


def test_a_part_as_long_as_the_file_starts_over(server: Server, tmp_path: Path) -> None:
    server.files["/file"] = CONTENT
    (tmp_path / "file.part").write_bytes(CONTENT)
    mark = f'"{hashlib.sha1(CONTENT).hexdigest()}"'
    (tmp_path / "file.part.version").write_text(mark)
    get(server, tmp_path / "file")
    assert (tmp_path / "file").read_bytes() == CONTENT


def test_a_data_set_is_checked_unpacked_and_cleaned_up_after(
    server: Server, tmp_path: Path
) -> None:
    content = zipped({"Set40/a/one.off": b"OFF", "Set40/b.txt": b"x", "__MACOSX/._b": b"litter"})
    server.files["/set.zip"] = content
    place = fetch(dataset(server, hashlib.md5(content).hexdigest()), tmp_path)
    assert place == tmp_path / "Set40"
    assert (place / "a" / "one.off").read_bytes() == b"OFF"
    assert sorted(path.name for path in tmp_path.rglob("*") if path.is_file()) == [
        "b.txt",
        "one.off",
    ]
    fetch(dataset(server), tmp_path)
    assert len(server.ranges) == 1


def test_archives_of_one_data_set_unpack_into_one_folder(server: Server, tmp_path: Path) -> None:
    server.files["/depth.zip"] = zipped({"sofa_1/depth.txt": b"d"})
    server.files["/mono.zip"] = zipped({"sofa_1/calibration.txt": b"c"})
    archives = [Archive(f"{server.address}/{name}.zip") for name in ("depth", "mono")]
    place = fetch(Dataset("ETH3D", "sofa_1", archives, 100), tmp_path)
    assert sorted(path.name for path in place.iterdir()) == ["calibration.txt", "depth.txt"]


def test_a_wrong_checksum_deletes_the_download(server: Server, tmp_path: Path) -> None:
    server.files["/set.zip"] = zipped({"Set40/a": b"a"})
    with pytest.raises(DownloadError, match="MD5"):
        fetch(dataset(server, "0" * 32), tmp_path)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_offline_it_says_what_to_do_by_hand(server: Server, tmp_path: Path) -> None:
    nowhere = Dataset("Set", "Set40", (Archive("http://127.0.0.1:9/set.zip"),), 10)
    with pytest.raises(DownloadError) as caught:
        fetch(nowhere, tmp_path)
    message = str(caught.value)
    assert "can't be reached" in message
    assert "http://127.0.0.1:9/set.zip elsewhere" in message
    assert str(tmp_path / "Set40") in message
    with pytest.raises(DownloadError, match="404"):
        fetch(dataset(server), tmp_path)


def outward() -> list[tuple[str, bytes]]:
    link = zipfile.ZipInfo("Set40/link")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr(link, "/etc/passwd")
    return [
        ("link", stream.getvalue()),
        ("leads out", zipped({"Set40/../../evil": b"x"})),
        ("leads out", zipped({"/evil": b"x"})),
        ("leads out", zipped({"C:\\evil": b"x"})),
        ("leads out", zipped({"Set40\\..\\..\\evil": b"x"})),
        ("at most 1000", zipped({"Set40/big": bytes(2000)})),
        ("damaged", zipped({"Set40/a": b"hello"}).replace(b"hello", b"jello")),
        ("damaged", b"no archive"),
    ]


@pytest.mark.parametrize(("problem", "content"), outward())
def test_unsafe_archives_write_nothing_outside(
    tmp_path: Path, problem: str, content: bytes
) -> None:
    (tmp_path / "set.zip").write_bytes(content)
    with pytest.raises(DownloadError, match=problem):
        unpack(tmp_path / "set.zip", tmp_path / "deep" / "folder", 1000)
    inside = (tmp_path / "deep").rglob("*")
    assert all(path.is_relative_to(tmp_path / "deep" / "folder") for path in inside)
    assert not list(tmp_path.glob("evil"))


def test_an_archive_of_something_else_is_refused(server: Server, tmp_path: Path) -> None:
    server.files["/set.zip"] = zipped({"Other/a": b"a"})
    with pytest.raises(DownloadError, match="no folder Set40"):
        fetch(dataset(server), tmp_path)


def test_sequences_are_named_or_listed(server: Server, tmp_path: Path) -> None:
    (named,) = eth3d_sequences(tmp_path, ["sofa_1"])
    assert [archive.filename for archive in named.archives] == [
        "sofa_1_mono.zip",
        "sofa_1_rgbd.zip",
    ]
    server.files["/list.txt"] = b"cables_1\nsofa_1\n"
    listed = eth3d_sequences(tmp_path, None, f"{server.address}/list.txt")
    assert [sequence.folder for sequence in listed] == ["cables_1", "sofa_1"]
    with pytest.raises(DownloadError, match="--sequence"):
        eth3d_sequences(tmp_path, None, f"{server.address}/missing.txt")
    with pytest.raises(InvalidOptionError, match="sequence"):
        eth3d_sequences(tmp_path, ["../evil"])


def test_the_command_fetches_and_says_where(
    server: Server,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    server.files["/set.zip"] = zipped({"Set40/a": b"a"})
    monkeypatch.setitem(command.DATASETS, "modelnet40", dataset(server))
    assert data_command(["fetch", "modelnet40", str(tmp_path)]) == 0
    assert "Set is in" in capsys.readouterr().err
    assert (tmp_path / "Set40" / "a").is_file()
