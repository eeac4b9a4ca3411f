from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo import main_ape, main_rpe
from evo.core import metrics as evo_metrics
from evo.core import sync
from evo.core.trajectory import Plane
from evo.tools import file_interface

from quadlog.errors import NoCommonTime
from quadlog.metrics.summary import value_of
from quadlog.pipelines.evaluation.reference import REFERENCE_METRICS, OnTime, Reference, compare_with_reference
from quadlog.pipelines.request import ReplayOutcome
from quadlog.results.record import read_metrics
from quadlog.storage.formats.tum import read_tum, write_tum

NS = 1_000_000_000
EPOCH_NS = 1_767_225_600 * NS


@pytest.fixture
def truth(short_run: ReplayOutcome, tmp_path: Path) -> Path:
    """A reference of half the rate with noise in all six directions, times rounded to microseconds."""
    return write_truth(tmp_path / "truth.tum", short_run.run)


def write_truth(path: Path, run: Path, clock_ns: int = 0) -> Path:
    poses, rng = read_tum(run / "reference.tum"), np.random.default_rng(0)
    lines = []
    for t, position_m, quat in zip(poses.t_ns[3::2], poses.position_m[3::2], poses.quat_xyzw[3::2], strict=True):
        seconds = (int(t) + clock_ns + rng.integers(-2_000_000, 2_000_000)) // 1000
        values = [*(position_m + rng.normal(0, 0.1, 3)), *(quat + rng.normal(0, 0.05, 4))]
        lines.append(f"{seconds // 10**6}.{seconds % 10**6:06d} {' '.join(f'{value:.9f}' for value in values)}\n")
    path.write_text("# time x y z\n" + "".join(lines))
    return path


def by_evo(truth: Path, run: Path, how: OnTime) -> dict[str, float]:
    found = {}
    for name, tool, extra in (("ate_rmse_m", main_ape.ape, {}), ("rpe_rmse_m", main_rpe.rpe, _STEPS)):
        pair = sync.associate_trajectories(
            *(file_interface.read_tum_trajectory_file(str(path)) for path in (truth, run / "trajectory.tum")),
            max_diff=how.max_difference_s,
            offset_2=how.offset_s,
        )
        plane = Plane.XY if how.planar else None
        part = evo_metrics.PoseRelation.translation_part
        found[name] = tool(*pair, part, align=how.align, project_to_plane=plane, **extra).stats["rmse"]
    return found


_STEPS = {"delta": 1, "delta_unit": evo_metrics.Unit.frames}


@pytest.mark.parametrize(
    "how",
    [
        OnTime(),
        OnTime(align=True),
        OnTime(align=True, planar=True),
        OnTime(max_difference_s=0.0005),
        OnTime(offset_s=0.31),
        OnTime(offset_s=-0.2, max_difference_s=0.05, align=True),
    ],
)
def test_equal_to_evo(short_run, truth, how):
    compared = compare_with_reference(short_run.run, Reference.read(truth, how))
    for name, value in by_evo(truth, short_run.run, how).items():
        assert value_of(compared.samples[name]) == pytest.approx(value, abs=1e-9), name


def test_the_runs_own_reference_gives_the_runs_own_metrics(short_run):
    saved = read_metrics(short_run.run)
    own = Reference.read(short_run.run / "reference.tum", OnTime())
    samples = compare_with_reference(short_run.run, own).samples
    timed = {"reference_time_offset_s", "ate_time_corrected_rmse_m"}  # of which three seconds are too few
    assert set(samples) == set(REFERENCE_METRICS) - timed
    for name, each in samples.items():
        assert value_of(each) == pytest.approx(saved[name]["value"], rel=1e-12), name
        assert len(each.values) == saved[name]["n"], name


def walking(seconds: float) -> np.ndarray:
    """Positions (N, 2) at 20 Hz of a walk that turns."""
    at_s = np.arange(0, seconds, 0.05)
    turned_rad = 0.3 * at_s + 2 * np.sin(at_s / 4)
    return np.cumsum(0.03 * np.column_stack([np.cos(turned_rad), np.sin(turned_rad)]), axis=0)


def noisy(position_m: np.ndarray) -> np.ndarray:
    return position_m + np.random.default_rng(0).normal(0, 0.03, position_m.shape)


def saved_walk(folder: Path, position_m: np.ndarray) -> Path:
    """A run of nothing but poses at 20 Hz."""
    folder.mkdir()
    write_tum(
        folder / "trajectory.tum", EPOCH_NS + np.arange(len(position_m)) * NS // 20, *position_m.T, 0 * position_m[:, 0]
    )
    return folder


def test_a_clock_that_differs_is_refused_with_its_offset(tmp_path):
    position_m = walking(40)
    run = saved_walk(tmp_path / "walk", noisy(position_m))
    truth = tmp_path / "truth.tum"
    t_ns = EPOCH_NS + 3600 * NS + np.arange(len(position_m)) * NS // 20
    for rows in (slice(None), slice(None, None, 40), slice(160, None)):
        write_tum(truth, t_ns[rows], *position_m[rows].T, 0 * t_ns[rows])
        with pytest.raises(NoCommonTime) as told:
            compare_with_reference(run, Reference.read(truth, OnTime()))
        words = str(told.value)
        assert "\n" not in words
        assert "overlap 0.000 s" in words
        for each_ns in read_tum(truth).t_ns[[0, -1]]:
            assert f"{each_ns / NS:.3f}" in words
        offset_s = float(words.split("--t-offset ")[1])
        assert offset_s == pytest.approx(3600, abs=0.1)
        back = compare_with_reference(run, Reference.read(truth, OnTime(0.03, offset_s)))
        assert value_of(back.samples["ate_rmse_m"]) < 0.1
