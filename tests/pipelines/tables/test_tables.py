"""Every table of the papers, from few draws or made-up walks: the contract of a table, and what draws as committed.

Nothing in expected/ is of made-up walks, whose numbers are this file's own.

After a wanted change of a number: python tests/pipelines/tables/test_tables.py
"""

from __future__ import annotations

import csv
import importlib
import io
import re
import zlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from quadlog.pipelines.tables.foot import drift_walks
from quadlog.pipelines.tables.foot.drift_walks import ROBOTS, Drifted, DriftTask
from quadlog.pipelines.tables.registry import TABLES
from quadlog.pipelines.tables.tracking import courses, table_5
from quadlog.pipelines.tables.tracking.walks import CURVES, Tracked, TrackingTask
from quadlog.results.papers.folder import csv_text
from quadlog.results.papers.table import PaperTable, Verdict

EXPECTED = Path(__file__).parent / "expected"
SMALL: dict[str, dict[str, int]] = {
    "following-uwb": {"FAST_FIXES": 300, "FAST_RUNS": 2},
    "following-lidar": {"FAST_SCANS": 2},
    "following-2": {"FAST_WALKS": 1},
    "planning-1": {"FAST_WALKS": 2},
    "planning-2": {"FAST_EPISODES": 2},
    "planning-ea": {"FAST_CROSSINGS": 20},
}
"""How few each of these draws here. The walks of the others are made up, so that these run in full."""
SEEDLESS = "foot-torque"
RECORDED = "uwb-real"
"""Of real recordings, which not every machine has: `real/test_uwb_real.py`."""
DRAWN = [
    pytest.param(name, marks=pytest.mark.nightly) if name in SMALL else name for name in TABLES if name != RECORDED
]
COMMITTED = [*(pytest.param(name, marks=pytest.mark.nightly) for name in SMALL), SEEDLESS]
UNEXPLAINED = ("Figs 9 and 10: ranges", "Curves chosen for each robot", "Sweep of k")
"""Groups that leave the words on their intervals to another one."""
T_S = np.linspace(0, 60, 50)


def tracked(task: TrackingTask) -> Tracked:
    """Its η grows with the look-ahead, is worse without whole-body control, and differs by seed; some fall."""
    steering = task.steering
    l_m = 1.5 if steering.controller != "pmw" else steering.lookahead_m
    fell = steering.controller == "fpm" and (task.turning_share == 1.0 or (task.disturbed and task.seed % 3 == 0))
    eta_m = 0.01 * l_m * (1 + 0.01 * (task.seed % 7)) * (1.5 if steering.controller == "fpm" else 1.0)
    eta_m *= {"6cm": 1.3}.get(task.terrain, 1.0) * (1.2 if task.disturbed else 1.0) * (0.8 / (task.friction or 0.8))
    names = ("sigma_m", "eta_time_m", "sigma_time_m", "max_error_m", "heading_rmse_rad", "pitch_rms_rad")
    figures = dict.fromkeys((*names, "height_rms_m"), eta_m)
    figures |= {figure.key: eta_m for figure in (*courses.CURVED, *table_5.CURVED)}
    figures |= {"eta_m": eta_m, "fallen": float(fell), "lookahead_mean_m": l_m, "lookahead_range_m": 1 + eta_m}
    figures |= {"speed_mean_mps": 0.59} | ({} if fell else {"completion_time_s": 52.6})
    return Tracked(
        figures, T_S, eta_m * (1 + np.sin(T_S)), {name: np.sin(T_S) for name in CURVES} if task.drawn else {}
    )


def drifted(as_claimed: bool, task: DriftTask) -> Drifted:
    """Of every robot what the paper says of its own, or the contrary, with noise of the seed and a little of y(t)."""
    own = np.random.default_rng([task.seed, list(ROBOTS).index(task.robot)]).normal()
    curve = np.random.default_rng([task.seed, zlib.crc32(repr(task.curve).encode())]).normal()
    noise = 0.02 * own + 0.001 * curve
    less = (task.curve.k is not None) == as_claimed
    figures = {
        "lateral_drift_m": -(0.04 if less else 0.28) + 0.1 * noise,
        "yaw_rate_degps": (0.03 if less else -0.25) + 0.01 * noise,
        "forward_m": (2.6 if less else 2.5) + 0.1 * noise,
        "roll_range_deg": 1.0,
        "pitch_range_deg": 1.0,
    }
    t_s = np.linspace(0, 32, 40)
    return Drifted(figures, 0.01, t_s, 0.01 * np.sin(t_s), 0.01 * np.cos(t_s))


def drift_table(as_claimed: bool, fast: bool) -> PaperTable:
    def walk_all(tasks: Iterable[DriftTask]) -> dict[DriftTask, Drifted]:
        return {task: drifted(as_claimed, task) for task in tasks}

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drift_walks, "walk_all", walk_all)
        return importlib.import_module(TABLES["foot-drift"]).make_table(fast, 0)


@cache
def small(name: str, seed: int = 0) -> PaperTable:
    if name == "foot-drift":
        return drift_table(as_claimed=True, fast=False)
    module = importlib.import_module(TABLES[name])
    with pytest.MonkeyPatch.context() as patch:
        for size, count in SMALL.get(name, {}).items():
            patch.setattr(module, size, count)
        for each in (courses, table_5):
            patch.setattr(each, "walk_all", lambda tasks: [tracked(task) for task in tasks])
        return module.make_table(name in SMALL, seed)


def unlike(table: PaperTable, expected: str) -> list[str]:
    """The rows of a table that are not as expected: other words or verdicts, or numbers apart by more than 0.1 %."""
    found, wanted = ({row["quantity"]: row for row in csv.DictReader(io.StringIO(text))}
                     for text in (csv_text(table), expected))  # fmt: skip
    assert list(found) == list(wanted)
    texts, numbers = ("reproduces", "note"), ("paper", "ours", "low", "high")
    return [
        f"{name}: {row}, expected {wanted[name]}"
        for name, row in found.items()
        if any(row[key] != wanted[name][key] for key in texts)
        or [float(row[key] or "nan") for key in numbers]
        != pytest.approx([float(wanted[name][key] or "nan") for key in numbers], rel=1e-3, abs=1e-6, nan_ok=True)
    ]


@pytest.mark.parametrize("name", COMMITTED)
def test_its_rows_are_as_committed(name: str):
    assert unlike(small(name), (EXPECTED / f"{name}.csv").read_text()) == []


@pytest.mark.parametrize("name", DRAWN)
def test_it_keeps_the_contract_of_a_table(name: str):
    table = small(name)
    assert table.name == name
    assert table.command == f"quadlog tables {name}{' --fast' if name in SMALL else ''}"
    assert "seed" in table.sizes
    assert not re.search(r"\bnan\b", csv_text(table))
    for row in table.rows:
        assert row.paper is None or row.reproduces is not None, row
        # Of what the paper prints without a number, the note says what is claimed.
        assert row.paper is not None or row.reproduces is None or "laimed" in row.note, row
        assert row.note or row.low is not None or row.reproduces is not Verdict.NO, row
        assert row.note or row.reproduces is not Verdict.NOT_COMPARABLE, row
    for group in table.groups:
        if any(row.low is not None for row in group.rows):
            assert "nterval" in group.text or group.title in UNEXPLAINED, group.title
    assert table.pictures
    for picture in table.pictures:
        with Image.open(io.BytesIO(picture.png)) as image:
            assert image.width == 1200
            assert len(image.convert("RGB").getcolors(maxcolors=1 << 24)) > 50
        assert picture.alt
        assert picture.caption


@pytest.mark.parametrize("name", [pytest.param("following-uwb", marks=pytest.mark.nightly), SEEDLESS])
def test_the_same_seed_gives_the_same_table_to_the_byte_and_another_one_another(name: str):
    again = small.__wrapped__(name)
    assert again == small(name)
    assert (small(name, 7).rows == again.rows) == (name == SEEDLESS)


def test_tracking_chooses_on_seeds_that_it_does_not_report(monkeypatch: pytest.MonkeyPatch):
    asked: list[TrackingTask] = []
    monkeypatch.setattr(table_5, "walk_all", lambda tasks: asked.extend(tasks) or [tracked(task) for task in tasks])
    monkeypatch.setattr(table_5, "_pictures", lambda *_: ())
    full, fast = table_5.make_table(False, 0), table_5.make_table(True, 0)
    assert {task.seed for task in asked if task.seed < 1000} == set(table_5.CHOOSING_SEEDS)
    assert all(task.steering.controller == "pmw" for task in asked if task.seed < 1000)
    assert min(task.seed for task in asked if task.seed >= 1000) == 2000
    assert "walks drawn from seeds 2000 to 2009" in full.sizes
    assert "walks drawn from seeds 2000 to 2001" in fast.sizes


@pytest.mark.parametrize(("as_claimed", "says"), [
    (True, "On most robots less drift and a lower yaw rate and a longer way survives of the claim."),
    (False, "On most robots nothing survives of the claim; not less drift (on no robot)"),
])  # fmt: skip
@pytest.mark.parametrize("fast", [False, True])
def test_foot_drift_says_which_claims_survive(as_claimed: bool, says: str, fast: bool):
    table = drift_table(as_claimed, fast)
    assert table.groups[0].text.startswith(says)
    assert ("with a trim to one side" in table.groups[0].text) == (as_claimed and not fast)
    claimed = [row for row in table.rows if "change of" in row.quantity]
    assert len(claimed) == (3 if fast else 7) * len(ROBOTS) + 2 * 3 * 2  # those of other frictions
    claimed = [row for row in claimed if "with y(t)" in row.quantity and row.reproduces is not None]
    assert len(claimed) == 3 * len(ROBOTS)
    assert {row.reproduces for row in claimed} == {Verdict.YES if as_claimed else Verdict.NO}


if __name__ == "__main__":
    for each in (*SMALL, SEEDLESS):
        (EXPECTED / f"{each}.csv").write_text(csv_text(small(each)))
