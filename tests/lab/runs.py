"""Ways in which run folders differ: each function changes the tests' tiny run in place."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from quadlog.config.schema import Config
from quadlog.results.arrays import MapsWriter
from quadlog.results.record import InputRecord, RunRecord, read_record, write_record
from quadlog.results.run import Run, create_run
from quadlog.results.tables import TABLES, has_table, read_table, write_table

UWB = ("fixes", "ranges", "links", "innovations", "uwb_errors", "pose_uncertainty")
LIDAR = ("scans", "cloud_samples", "ground", "maps", "plans", "paths", "astar", "clearances")
WALK = ("control", "contacts", "clearances", "resim_plans", "resim_paths")


def begin_run(path: Path, config: Mapping[str, Any] | None = None) -> Run:
    """A run that is begun, with nothing but its record and its configuration."""
    record = RunRecord(
        quadlog_version="1",
        command=["quadlog"],
        config=Config.model_validate(config or {}),
        options={},
        input=InputRecord(path="walk.mcap", size_bytes=1, sha256="ab"),
        seed=0,
        recorded_s=1.0,
    )
    path.mkdir(parents=True, exist_ok=True)
    return create_run(path, record)


def unfinish(run: Path) -> None:
    """As a kill leaves it."""
    write_record(run, read_record(run), finished=False)


def remove(run: Path, *names: str) -> None:
    """Remove tables and arrays by name."""
    for name in names:
        for suffix in (".parquet", ".npz"):
            (run / f"{name}{suffix}").unlink(missing_ok=True)


def change(run: Path, name: str, **columns: Any) -> None:
    """Replace columns of a table; a function gets the old values."""
    table = read_table(run, name)
    new = {key: value(table[key]) if callable(value) else value for key, value in columns.items()}
    write_table(run / f"{name}.parquet", TABLES[name], table | new)


def change_json(path: Path, **entries: Any) -> None:
    """Replace entries of a JSON file; in a name, __ leads into an inner object."""
    content = json.loads(path.read_text())
    for name, value in entries.items():
        *way, last = name.split("__")
        inner = content
        for part in way:
            inner = inner[part]
        inner[last] = value
    path.write_text(json.dumps(content))


def without_lidar(run: Path) -> None:
    """Nothing is mapped, planned or walked."""
    remove(run, *LIDAR, *WALK)


def without_uwb(run: Path) -> None:
    """Positions from odometry."""
    remove(run, *UWB)
    change(run, "poses", source="odometry")
    change_json(run / "run.json", config__uwb={})


def with_one_scan(run: Path) -> None:
    """All tables end with the first instant."""
    first_ns = int(read_table(run, "poses")["t_ns"][0])
    for name in (name for name in TABLES if has_table(run, name)):
        table = read_table(run, name)
        if "t_ns" in table:
            rows = table["t_ns"] == first_ns
            write_table(run / f"{name}.parquet", TABLES[name], {key: of[rows] for key, of in table.items()})
    change_json(run / "run.json", recorded_s=0.0)


def with_gap(run: Path) -> None:
    """After two seconds nothing is recorded for 30 s; the reference goes on."""
    for name in (name for name in TABLES if has_table(run, name)):
        if "t_ns" in (table := read_table(run, name)):
            late = table["t_ns"] >= read_table(run, "scans")["t_ns"][0] + 2_000_000_000
            table["t_ns"] = table["t_ns"] + 30_000_000_000 * (late if name != "scans" else 0)
            write_table(run / f"{name}.parquet", TABLES[name], table)
    change_json(run / "run.json", recorded_s=34.0, counts__unlocated_ms=30_000)


def with_many_anchors(run: Path, anchors: int = 12, tags: int = 6) -> None:
    """So many anchors and tags, late ranges, errors of each tag."""
    angle_rad = np.linspace(0, 2 * np.pi, anchors, endpoint=False)
    anchors_m = 6 * np.column_stack([np.cos(angle_rad), np.sin(angle_rad)]) + (1.5, 1.5)
    places = [{"id": 10 + k, "x_m": x, "y_m": y} for k, (x, y) in enumerate(anchors_m.tolist())]
    change_json(run / "run.json", config__uwb={"anchors": places, "tag_height_m": 0.6})
    t_ns = read_table(run, "poses")["t_ns"]
    tag, anchor = (grid.ravel() for grid in np.meshgrid(np.arange(tags), 10 + np.arange(anchors)))
    links = tags * anchors
    row = {"t_ns": np.tile(t_ns, links), "tag": np.repeat(tag, 40), "anchor": np.repeat(anchor, 40)}
    noise_m = np.random.default_rng(1).normal(0, 0.1, links * 40)
    noise_m[7::10] = 1.5
    ranges = row | {"range_m": 5 + noise_m, "predicted_m": 5.0, "weight": 1.0}
    write_table(run / "ranges.parquet", TABLES["ranges"], ranges)
    of_links = dict.fromkeys(TABLES["links"].names, 0.1) | {"tag": tag, "anchor": anchor, "n": 40, "why_not": ""}
    write_table(run / "links.parquet", TABLES["links"], of_links | {"bias_applied": True})
    errors = {"t_ns": np.tile(t_ns, tags), "tag": np.repeat(np.arange(tags), 40), "source": "track"}
    errors |= {"error_x_m": np.linspace(0, 0.3, 40 * tags), "error_y_m": 0.0, "bound_m": 0.2}
    write_table(run / "uwb_errors.parquet", TABLES["uwb_errors"], errors)


def with_large_map(run: Path) -> None:
    """500 m along x, at whose ends there is a wall."""
    for name in ("poses", "control"):
        change(run, name, x_m=lambda x_m: np.linspace(0, 500, len(x_m)), y_m=0.0)
    t_ns = read_table(run, "poses")["t_ns"]
    wall = np.zeros((60, 50), np.bool_)
    wall[10:50, 20:22] = True
    with MapsWriter(run / "maps.npz", 0.1, wall.shape) as maps:
        for number, t in enumerate(t_ns.tolist()):
            at_m = np.array([500 * number / 39 - 2.5, -3.0])
            maps.append(t, at_m, wall if number in (0, 39) else np.zeros_like(wall))


def until_ingest(run: Path) -> None:
    """Only the recording was read."""
    remove(run, *TABLES, "maps", "cloud_samples", "ground")
    (run / "metrics.json").write_text("{}")
    for name in ("trajectory.tum", "reference.tum"):
        (run / name).unlink(missing_ok=True)
    change_json(run / "run.json", stages=[{"name": "ingest", "seconds": 1.0, "peak_memory_mb": 100.0}])


def until_map(run: Path) -> None:
    """Not planned, not walked."""
    remove(run, "plans", "paths", "astar", *WALK)


def along_course(run: Path) -> None:
    """A simulated walk."""
    remove(run, *(name for name in TABLES if name not in ("control", "paths")), "maps", "cloud_samples")
    (run / "trajectory.tum").unlink(missing_ok=True)
    course = read_table(run, "paths")
    write_table(run / "paths.parquet", TABLES["paths"], {key: of[:10] for key, of in course.items()})
    options = {"course": "line", "controller": "fpmw", "seed": 0}
    change_json(run / "run.json", options=options, losses=[], topics=[])


def as_it_is(run: Path) -> None:
    """The tiny run itself."""


KINDS: dict[str, Callable[[Path], None]] = {
    "whole": as_it_is,
    "without lidar": without_lidar,
    "without UWB": without_uwb,
    "one scan": with_one_scan,
    "gap": with_gap,
    "12 anchors": with_many_anchors,
    "500 m": with_large_map,
    "ingest": until_ingest,
    "map": until_map,
    "course": along_course,
}
