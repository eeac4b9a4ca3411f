"""Run folders with any file replaced by arbitrary bytes, or any value of a table by a hostile one."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zlib import crc32

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fuzzing.oracles import command, expect, replaced
from quadlog.errors import ExitCode, QuadlogError
from quadlog.results.arrays import ARRAYS, MapsWriter, load_maps, read_arrays
from quadlog.results.foxglove import write_derived
from quadlog.results.run import finish_run, load_run, write_result
from quadlog.results.tables import TABLES, write_table
from quadlog.storage.formats.ros_map import write_rosmap
from quadlog.storage.formats.tum import write_tum
from tests.lab.runs import begin_run

_ROWS = 12
_START_NS = 1_700_000_000 * 10**9
_READ = (ExitCode.DONE, ExitCode.FAILED, ExitCode.CHECK_FAILED, ExitCode.WITH_LOSS)
_HOSTILE = (np.nan, np.inf, -np.inf, 1e300, -1e300, 1e100, 1e13, 1e-300, 0.0, -0.0, 2.0**63, -(2.0**53), 1.0)
_TEXTS = ("", "<script>alert(1)</script>", "=1+1", "a" * 5000, "\x1b[2J", "\n|`${x}", "\u202e", "ia_star")
_WHOLES = (0, -1, 1, 2**63 - 1, -(2**63), 2**53 + 1, _START_NS)
_TABLES = tuple(name for name in TABLES if name != "summary")


def write_run(folder: Path) -> None:
    """A finished run with every table of the contract, and every other file that is read again."""
    anchors = [{"id": 0, "x_m": 0.0, "y_m": 5.0}]
    run = begin_run(folder, {"uwb": {"anchors": anchors}, "planner": {"name": "ia_star"}})
    for name in _TABLES:
        write_table(folder / f"{name}.parquet", TABLES[name], _columns(name))
    t_ns = _START_NS + np.arange(_ROWS) * 10**8
    zero = np.zeros(_ROWS)
    write_tum(folder / "trajectory.tum", t_ns, zero, zero, zero)
    with MapsWriter(folder / "maps.npz", 0.1, (20, 20)) as maps:
        for t in t_ns.tolist():
            maps.append(t, np.zeros(2), np.eye(20, dtype=bool))
    write_rosmap(folder, np.zeros((20, 20), np.int8), np.zeros(2), 0.1)
    cloud: dict[str, Any] = {"t_ns": t_ns[:1], "offset": [0, 9], "xyz_m": np.ones((9, 3)), "label": np.zeros(9)}
    write_result(
        run, "cloud_samples", cloud | {"x_m": [0], "y_m": [0], "yaw_rad": [0], "classes": ["ground", "obstacle"]}
    )
    ground: dict[str, Any] = {"origin_m": np.zeros(2), "cell_m": 0.2, "height_m": np.zeros((8, 8))}
    write_result(run, "ground", ground | {"count": np.ones((8, 8))})
    write_result(
        run, "metrics", {name: {"value": 0.5, "n": 3, "unit": "m"} for name in ("eta_m", "sigma_m", "success_rate")}
    )
    write_derived(run)
    finish_run(run, run.record)


def _columns(name: str) -> dict[str, Any]:
    return {field.name: _sound(field) for field in TABLES[name]}


def _sound(field: pa.Field) -> Any:
    if field.name == "t_ns":
        return _START_NS + np.arange(_ROWS) * 10**8
    if field.type == pa.string():
        return np.array(["ia_star" if field.name == "planner" else "uwb"] * _ROWS, object)
    kinds = {pa.int64(): np.int64, pa.float64(): np.float64, pa.bool_(): np.bool_}
    return (np.arange(_ROWS) % 4 + (0.25 if field.type == pa.float64() else 0)).astype(kinds[field.type])


@cache
def _folders(folder: Path) -> tuple[Path, Path, tuple[str, ...]]:
    """A sound run, one whose files are replaced, and the names of these; every command has run once by then."""
    sound, case = folder / "sound", folder / "case"
    for each in (sound, case):
        write_run(each)
    names = tuple(sorted(each.name for each in case.iterdir()))
    (folder / "bounds.toml").write_text("[default]\neta_m = { max = 1.0 }\n")
    for arguments in _commands(sound, case, folder):
        command(*arguments, allowed=_READ)
    return sound, case, names


def run_files(folder: Path, data: bytes) -> None:
    """Any bytes as the file of a run that the first one chooses."""
    _, case, names = _folders(folder)
    name = names[(data or b"\0")[0] % len(names)]
    with replaced(case / name, data[1:]):
        for read in _readers(case):
            try:
                read()
            except QuadlogError as error:
                expect("\n" not in str(error), f"a message of several lines: {error}")
        _use(folder, data)


def run_file_seeds() -> list[bytes]:
    """Every file as it is."""
    with TemporaryDirectory() as folder:
        write_run(Path(folder) / "run")
        contents = [path.read_bytes() for path in sorted((Path(folder) / "run").iterdir())]
    return [bytes([i]) + content for i, content in enumerate(contents) if len(content) < 60_000]


RUN_TOKENS = (b"9" * 5000, b"1" + b"0" * 400, *b'null|NaN|Infinity|1e400|-1|[]|{}|"run_format": 2'.split(b"|"))


def run_values(folder: Path, data: bytes) -> None:
    """Hostile values in a table: which one, then column, row and value, three bytes each."""
    _, case, _ = _folders(folder)
    name = _TABLES[(data or b"\0")[0] % len(_TABLES)]
    columns = {key: np.array(values) for key, values in _columns(name).items()}
    for start in range(1, min(len(data), 40) - 2, 3):
        column, row, value = data[start : start + 3]
        key = list(columns)[column % len(columns)]
        columns[key][slice(None) if row >= 200 else row % _ROWS] = _hostile(columns[key].dtype, value)
    content = io.BytesIO()
    arrays = [pa.array(columns[field.name], field.type, from_pandas=False) for field in TABLES[name]]
    pq.write_table(pa.table(arrays, schema=pa.schema([field.with_nullable(True) for field in TABLES[name]])), content)
    with replaced(case / f"{name}.parquet", content.getvalue()):
        _use(folder, data)
        if crc32(data) % 32 == 0:  # a page takes seconds
            command("report", case, allowed=_READ)
            page = case / "report.html"
            is_script = page.exists() and "<script>alert" in page.read_text()
            expect(not is_script, "a value of a table is a script of the page")


def _hostile(dtype: np.dtype, value: int) -> Any:
    kinds: dict[str, Any] = {"O": _TEXTS, "f": _HOSTILE, "i": _WHOLES, "b": (False, True)}
    return kinds[dtype.kind][value % len(kinds[dtype.kind])]


def run_value_seeds() -> list[bytes]:
    """A few values in each table."""
    return [bytes([i, column, 255, value, 1]) for i in range(len(_TABLES)) for column, value in ((1, 0), (2, 3))]


def _readers(run: Path) -> list[Callable[[], Any]]:
    """Each on its own, so that one file's damage does not hide the others'."""
    tables = [partial(lambda name: load_run(run).table(name), name) for name in _TABLES]
    return [
        lambda: [tuple(each) for each in load_maps(run)],
        *(partial(read_arrays, run, of) for of in ARRAYS),
        *tables,
    ]


def _use(folder: Path, data: bytes) -> None:
    """One of the things that users do with runs, by the data, and what it prints."""
    sound, case, _ = _folders(folder)
    commands = _commands(sound, case, folder)
    chosen = commands[crc32(data) // 32 % len(commands)]
    _, out = command(*chosen, allowed=_READ)
    if "json" in chosen:
        json.loads(out or "[]")


def _commands(sound: Path, case: Path, folder: Path) -> list[tuple[str | Path, ...]]:
    export = [("export", case, "--force", "--to", to, "-o", folder / to) for to in ("tum", "mcap", "csv", "rosmap")]
    return [
        ("metrics", case, "--format", "json"),
        ("metrics", case, sound),
        ("metrics", case, "--reference", sound / "trajectory.tum"),
        ("metrics", case, "--explain", "eta_m"),
        ("diff", sound, case),
        ("check", case, "--expect", folder / "bounds.toml"),
        *export,
    ]
