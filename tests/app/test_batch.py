"""``equivalign batch``: manifests of every kind, rows of every kind, and what a re-run does."""

from __future__ import annotations

import functools
import json
import re
import socket
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="pyarrow isn't installed")
import pyarrow as pa
import pyarrow.parquet as pq
from batch_run import poses, registered_alone, results, write_pairs

from app.batch import run as batch_run_module
from app.batch.manifest import COLUMNS, ManifestError, ManifestRow, read_manifest
from app.batch.on_ray import ray_is_installed
from app.batch.pair import PairRegistrar
from app.batch.result_table import RESULT_SCHEMA, table_of
from app.batch.results import Results
from app.batch.run import Batch, engine_of
from app.batch.shard import shards_of
from app.batch.storage import Place, StorageError
from app.batch.worker import ShardWorker
from app.command_line import main
from app.schemas import RegisterOptions, RegisterResponse
from model import Registrar

ROOT = Path(__file__).resolve().parents[2]
TWO = {"source": ["a.npy", "b.npy"], "target": ["c.npy", "d.npy"]}
JSONL = '{"source": "a.npy", "target": "b.npy"}\n'


def parquet(columns: dict[str, list]) -> bytes:
    stream = pa.BufferOutputStream()
    pq.write_table(pa.table(columns), stream)
    return stream.getvalue().to_pybytes()


MALFORMED = {
    "missing column": ("p.csv", b"source,seed\na.npy,1\n", "manifest.target: this column is miss"),
    "no header": ("p.csv", b"a.npy,b.npy\nc.npy,d.npy\n", "manifest.a.npy: this column isn't kn"),
    "unknown column": ("p.jsonl", JSONL.replace("}", ', "sed": 1}').encode(), "manifest.sed: this"),
    "column twice": ("p.csv", b"source,target,target\na,b,c\n", "manifest.target: this column is"),
    "nothing in it": ("p.csv", b"", "manifest: the file is empty"),
    "a header only": ("p.csv", b"source,target\n", "manifest: it lists no pairs"),
    "no rows": ("p.parquet", parquet({"source": [], "target": []}), "manifest: it lists no pairs"),
    "mixed types, CSV": (
        "p.csv", b"source,target,seed\na,b,1\nc,d,one\n", "manifest: the file is broken",
    ),
    "mixed types, JSONL": (
        "p.jsonl",
        (JSONL + JSONL.replace("}", ', "seed": "one"}')).encode(),
        "manifest.seed: row 1 has another kind of value than a whole number (got 'one')",
    ),
    "mixed types, Parquet": (
        "p.parquet", parquet(TWO | {"seed": ["1", "2"]}), "manifest.seed: row 0 has another kind",
    ),
    "numbers for paths": ("p.jsonl", b'{"source": 1, "target": "b"}', "manifest.source: row 0 has"),
    "a broken pose": (
        "p.csv", b'source,target,initial\na,b,"[[1, 0"\n', "manifest.initial: row 0 has another",
    ),
    "the same id twice": (
        "p.parquet", parquet(TWO | {"pair_id": ["x", "x"]}), "manifest.pair_id: rows 0 and 1 have",
    ),
    "truncated Parquet": ("p.parquet", parquet(TWO)[:-9], "manifest: the file is broken"),
    "truncated JSONL": ("p.jsonl", JSONL.encode() + b'{"source": "a', "manifest: line 2 is broken"),
    "an array": ("p.jsonl", b'["a.npy", "b.npy"]', "manifest: line 1 isn't a JSON object"),
    "ragged CSV": ("p.csv", b"source,target\na,b,c\n", "manifest: the file is broken"),
    "not text": ("p.jsonl", b"\xff\xfe\x00", "manifest: the file is broken"),
    "another suffix": ("p.xlsx", b"PK", "manifest: the suffix isn't that of a manifest"),
}  # fmt: skip


@pytest.mark.parametrize("kind", MALFORMED)
def test_malformed_manifests_are_one_clear_line(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, content, said = MALFORMED[kind]
    (tmp_path / name).write_bytes(content)
    assert main(["batch", str(tmp_path / name), "--out", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"equivalign: {said}")
    assert error.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("path", "said"),
    [
        ("nowhere.csv", "manifest: the file can't be read: "),
        (".", "manifest: the suffix"),
        ("folder.csv", "manifest: the file can't be read: "),
        ("carrier-pigeon://coop/pairs.csv", "manifest: can't reach this storage"),
    ],
)
def test_unreadable_manifests_are_one_clear_line(
    path: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "folder.csv").mkdir()
    place = path if "://" in path else str(tmp_path / path)
    assert main(["batch", place, "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith(f"equivalign: {said}")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--workers", "0"], "workers: not a positive number"),
        (["--shard", "0"], "shard: not a positive number"),
        (["--engine", "processes", "--address", "auto"], "address: only Ray has clusters"),
        (["--artifact", "nowhere"], "artifact: "),
    ],
)
def test_bad_options_are_one_clear_line(
    arguments: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "p.jsonl").write_text(JSONL)
    words = ["batch", str(tmp_path / "p.jsonl"), "--out", str(tmp_path / "out"), *arguments]
    assert main(words) == 2
    assert capsys.readouterr().err.startswith(f"equivalign: {said}")


POSE = np.eye(4).tolist()


def test_the_same_pairs_in_every_format(tmp_path: Path) -> None:
    row = {"pair_id": "7", "source": "a.npy", "target": "sub/b.ply", "seed": 3, "deadline": 1.5,
           "max_rotation_deg": 90, "search": "local", "explain": True, "initial": POSE}  # fmt: skip
    (tmp_path / "p.jsonl").write_text(json.dumps(row | {"pair_id": 7, "solver": None}))
    pq.write_table(
        pa.table({name: [value] for name, value in row.items()} | {"initial": [np.ravel(POSE)]}),
        tmp_path / "p.parquet",
    )
    header = ",".join([*row, "points"])
    cells = [f'"{value}"' if isinstance(value, list) else str(value) for value in row.values()]
    (tmp_path / "p.csv").write_text(f"{header}\n{','.join(cells)},\n")
    manifests = [read_manifest(str(tmp_path / f"p.{kind}")) for kind in ("jsonl", "parquet", "csv")]
    assert manifests[0].rows[0].options == {
        name: value for name, value in row.items() if name not in ("pair_id", "source", "target")
    }
    for manifest in manifests:
        assert manifest.rows == manifests[0].rows
        assert manifest.folder == str(tmp_path)
        assert manifest.rows[0].digest("x") == manifests[0].rows[0].digest("x")
    assert read_manifest(str(tmp_path / "p.csv"), "s3://bucket/x").folder == "s3://bucket/x"


def test_every_option_of_register_is_a_column() -> None:
    assert set(RegisterOptions.model_fields) < set(COLUMNS)


def test_rows_without_an_id_have_their_number(tmp_path: Path) -> None:
    (tmp_path / "p.jsonl").write_text(JSONL * 3)
    rows = read_manifest(str(tmp_path / "p.jsonl")).rows
    assert [row.pair_id for row in rows] == ["0", "1", "2"]


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("clouds")
    write_pairs(folder, 6)
    np.save(folder / "nan.npy", np.full((9, 3), np.nan))
    np.save(folder / "flat.npy", np.outer(np.arange(9.0), [1, 2, 3]))
    (folder / "empty.xyz").touch()
    return folder


def row(number: int = 0, **changes: object) -> ManifestRow:
    told = {"source": "source-0.npy", "target": "target-0.npy"} | changes
    paths = {name: str(told.pop(name)) for name in ("source", "target")}
    return ManifestRow(number, f"pair-{number}", **paths, options=told)


@pytest.mark.parametrize(
    ("changes", "kind", "field"),
    [
        ({"source": "nowhere.npy"}, "unreadable-file", "source"),
        ({"target": ""}, "unreadable-file", "target"),
        ({"target": "empty.xyz"}, "unreadable-file", "target"),
        ({"source": "cloud.docx"}, "unknown-format", "source"),
        ({"source": "nan.npy"}, "non-finite-cloud", "source.points"),
        ({"target": "flat.npy"}, "degenerate-cloud", "target.points"),
        ({"seed": -1}, "invalid-option", "options.seed"),
        ({"max_rotation_deg": 720.0}, "invalid-option", "options.max_rotation_deg"),
        ({"solver": "magic"}, "invalid-option", "options.solver"),
        ({"points": 3}, "invalid-request", "options.points"),
        ({"deadline": float("nan")}, "invalid-request", "options.deadline"),
        ({"initial": [[1.0, 2.0]]}, "invalid-option", "options.initial"),
        ({"source": "carrier-pigeon://x.npy"}, "storage", "source"),
    ],
)
def test_a_bad_pair_is_a_row_with_an_error(
    changes: dict, kind: str, field: str, registrar: Registrar, clouds: Path
) -> None:
    told = PairRegistrar(registrar, "x", str(clouds))(row(**changes))
    assert told["error"]["type"] == f"urn:equivalign:problem:{kind}"
    assert told["error"]["field"] == field
    assert "T_target_source" not in told
    (again,) = table_of([told]).to_pylist()
    assert again["error"] == told["error"]
    assert again["diagnostics"] is again["T_target_source"] is None


def test_what_nobody_foresaw_is_an_error_too(registrar: Registrar, clouds: Path) -> None:
    class Broken:
        def register(self, *_: object, **__: object) -> None:
            raise ZeroDivisionError("by zero")

    told = PairRegistrar(Broken(), "x", str(clouds))(row())
    assert told["error"]["type"] == "urn:equivalign:problem:unexpected"
    assert told["error"]["detail"] == "ZeroDivisionError: by zero"


def test_results_hold_all_that_the_service_answers(registrar: Registrar, clouds: Path) -> None:
    told = PairRegistrar(registrar, "x", str(clouds))(row(explain=True, points=64))
    assert told["error"] is None
    table = table_of([told])
    assert table.schema == RESULT_SCHEMA
    (again,) = table.to_pylist()
    again["diagnostics"]["seconds"] = dict(again["diagnostics"]["seconds"])
    answer = RegisterResponse.model_validate(
        {name: again[name] for name in RegisterResponse.model_fields if name != "explanation"}
    )
    assert answer.T_target_source == told["T_target_source"]
    assert answer.diagnostics.points_source <= 64
    assert answer.diagnostics.trace
    assert json.loads(again["explanation"])["verdict"]
    assert again["seconds"] > again["seconds_reading"] > 0


def test_a_deadline_leaves_the_best_pose_with_the_error(registrar: Registrar, clouds: Path) -> None:
    told = PairRegistrar(registrar, "x", str(clouds))(row(deadline=1e-4))
    assert told["error"]["type"] == "urn:equivalign:problem:deadline-exceeded"
    assert told["diagnostics"]["deadline_reached"]
    assert np.shape(told["T_target_source"]) == (4, 4)
    table_of([told])


@pytest.fixture
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """An engine that needs no other process."""

    def here(shards: list, work: object, workers: int) -> Iterator:
        return map(ShardWorker(work), shards)

    monkeypatch.setattr(batch_run_module, "run_in_processes", here)


@pytest.mark.usefixtures("in_this_process")
def test_re_runs_add_what_is_missing_and_refuse_what_differs(
    artifact: Path, clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    manifest, out = tmp_path / "p.jsonl", tmp_path / "out"
    all_lines = [
        json.dumps(json.loads(line) | {"initial": POSE, "search": "local"})
        for line in (clouds / "pairs.jsonl").read_text().splitlines()
    ]
    bad = json.dumps({"pair_id": "bad", "source": "later.npy", "target": "target-0.npy"})
    words = ["batch", str(manifest), "--out", str(out), "--artifact", str(artifact), "--json"]
    words += ["--engine", "processes", "--root", str(clouds), "--shard", "2"]

    def run(lines: list[str], *more: str) -> dict:
        manifest.write_text("\n".join(lines))
        code = main([*words, *more])
        said, complaint = capsys.readouterr()
        return json.loads(said) if code == 0 else {"code": code, "complaint": complaint}

    first = run([*all_lines[:3], bad])
    assert (first["pairs"], first["succeeded"]) == (4, 3)
    assert first["errors"] == {"unreadable-file": 1}
    assert json.loads((out / "_summary.json").read_text()) == first
    shards = {path.name: path.read_bytes() for path in out.glob("*.parquet")}

    assert run([*all_lines[:3], bad])["registered_now"] == 0
    assert {path.name: path.read_bytes() for path in out.glob("*.parquet")} == shards

    # The manifest grows, in another order, and one result is deleted by hand.
    next(out.glob("part-*")).unlink()
    grown = run([*all_lines[::-1], bad])
    assert grown["pairs"] == 7
    assert grown["registered_now"] == 5
    assert results(out).num_rows == 7

    np.save(clouds / "later.npy", np.load(clouds / "source-0.npy"))
    mended = run([*all_lines, bad], "--retry-errors")
    assert (mended["succeeded"], mended["registered_now"], mended["errors"]) == (7, 1, {})
    assert sorted(results(out)["pair_id"].to_pylist()) == sorted(
        ["bad", *(f"pair-{number}" for number in range(6))]
    )

    other = json.dumps(json.loads(all_lines[0]) | {"seed": 99})
    refused = run([other])
    assert refused["code"] == 2
    assert "this pair has a result already, for other paths, options" in refused["complaint"]
    assert "'pair-0'" in refused["complaint"]

    pq.write_table(pa.table({"x": [1]}), out / "foreign.parquet")
    assert "doesn't hold results" in run(all_lines)["complaint"]
    (out / "foreign.parquet").write_bytes(b"broken")
    assert "can't be read as results" in run(all_lines)["complaint"]
    (out / "foreign.parquet").unlink()
    doubled = next(out.glob("part-*"))
    (out / "copy.parquet").write_bytes(doubled.read_bytes())
    assert "more than once" in run(all_lines)["complaint"]


@pytest.mark.usefixtures("in_this_process")
def test_the_summary_in_words(
    artifact: Path, clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["batch", str(clouds / "pairs.jsonl"), "--out", str(tmp_path), "--engine", "processes"]
    assert main([*words, "--artifact", str(artifact)]) == 0
    said = capsys.readouterr().out
    assert "6, 0 finished before" in said
    assert "Errors     0" in said
    assert "pairs/s" in said


class Quiet(SimpleHTTPRequestHandler):
    def log_message(self, *_: object) -> None:
        """Nothing."""


@pytest.fixture
def web(clouds: Path) -> Iterator[str]:
    handler = functools.partial(Quiet, directory=str(clouds))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


def test_manifest_and_clouds_from_a_remote_storage(
    registrar: Registrar, artifact: Path, clouds: Path, web: str
) -> None:
    manifest = read_manifest(f"{web}/pairs.jsonl")
    assert manifest.folder == web
    register = PairRegistrar(registrar, "x", manifest.folder)
    told = register(manifest.rows[0])
    alone = registered_alone(clouds / "pairs.jsonl", artifact)
    np.testing.assert_array_equal(told["T_target_source"], alone["pair-0"])
    missing = register(row(source="nowhere.npy"))
    assert missing["error"]["type"] == "urn:equivalign:problem:unreadable-file"
    with pytest.raises(ManifestError, match="can't be read"):
        read_manifest(f"{web}/nowhere.csv")


@pytest.mark.parametrize("kind", ["memory", "file"])
def test_results_in_a_remote_storage(
    kind: str, registrar: Registrar, clouds: Path, tmp_path: Path
) -> None:
    place = f"memory://{tmp_path.name}/out" if kind == "memory" else f"file://{tmp_path}/out"
    store = Results.at(place)
    assert store.finished() == {}
    rows = read_manifest(str(clouds / "pairs.jsonl")).rows[:2]
    (shard,) = shards_of(rows, "x", 64)
    assert store.begin(shard) == 0
    register = PairRegistrar(registrar, "x", str(clouds))
    records = [register(row) for row in shard.rows]
    store.write(shard, records)
    assert store.has(shard)
    assert store.begin(shard) == 1
    store.place.child(".part-left").write(b"by a killed worker")
    store.tidy()
    assert store.begin(shard) == 0
    store.end(shard)
    assert store.finished() == {row.pair_id: row.digest("x") for row in rows}
    assert store.place.files() == [shard.name]
    found = poses(store.columns("pair_id", "T_target_source"))
    for told in records:
        np.testing.assert_array_equal(found[told["pair_id"]], told["T_target_source"])
    assert store.forget_errors() == 0


def test_a_file_is_complete_or_not_there(tmp_path: Path) -> None:
    place = Place.of(str(tmp_path / "file"), "out")
    place.write(b"old")

    class Full:
        def __enter__(self) -> Full:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def write(self, _: bytes) -> None:
            raise OSError(28, "No space left on device")

    class Storage:
        def open_output_stream(self, _: str) -> Full:
            return Full()

    full = Place(place.address, Storage(), place.path)
    with pytest.raises(OSError, match="No space left"):
        full.write(b"new")
    assert place.read() == b"old"
    (shard,) = shards_of([row()], "x", 1)
    with pytest.raises(StorageError, match="out: the results can't be written: No space left"):
        Results(full).write(shard, [])


@pytest.mark.skipif(not ray_is_installed(), reason="Ray isn't installed")
def test_a_cluster_that_is_not_there_is_one_clear_line(
    artifact: Path, clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        nobody = f"127.0.0.1:{probe.getsockname()[1]}"
    words = ["batch", str(clouds / "pairs.jsonl"), "--out", str(tmp_path), "--engine", "ray"]
    assert main([*words, "--artifact", str(artifact), "--address", nobody]) == 2
    assert capsys.readouterr().err.startswith("equivalign: address: can't reach or start Ray")


def test_the_engine_is_ray_where_it_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = Batch("p.csv", "out", None, None, 1)
    for installed, engine in ((True, "ray"), (False, "processes")):
        monkeypatch.setattr(batch_run_module, "ray_is_installed", lambda there=installed: there)
        assert engine_of(asked) == engine


def test_the_guide_names_every_column() -> None:
    guide = (ROOT / "docs" / "beyond-one-machine.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (`.*?) \|", guide, re.MULTILINE)
    named = {name for cell in rows for name in re.findall(r"`(\w+)`", cell)}
    assert named >= {*COLUMNS, *RESULT_SCHEMA.names}
