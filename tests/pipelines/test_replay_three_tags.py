"""Three tags on one trolley (uwb_lias) from file to tables: one body, whose poses and yaw are from all of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from scipy.spatial.transform import Rotation

from quadlog.config.schema import Config
from quadlog.geometry import wrap_angle
from quadlog.pipelines.executor.progress import Kept
from quadlog.pipelines.replay import replay
from quadlog.pipelines.request import ReplayOptions, ReplayRequest

pytestmark = pytest.mark.nightly


def config_of(lias, levers_m) -> Config:
    anchors = [{"id": i, "x_m": x, "y_m": y, "z_m": z} for i, (x, y, z) in enumerate(lias.anchors_m.tolist())]
    tags = [{"id": i, "role": "robot", "height_m": 0.97, "x_m": x, "y_m": y} for i, (x, y) in enumerate(levers_m)]
    return Config.model_validate({"uwb": {"anchors": anchors, "tags": tags}})


def run(lias, folder: Path, config: Config, **options):
    kept = Kept()
    request = ReplayRequest(
        lias.folder / "lias_fast.mcap", folder, config, ReplayOptions(until="position", **options), plots=False
    )
    return replay(request, kept), kept.lines


def test_one_track_from_all_tags(lias, tmp_path):
    outcome, lines = run(lias, tmp_path / "run", config_of(lias, lias.levers_m.tolist()))
    table = pq.read_table(outcome.run / "poses.parquet").to_pandas()
    truth = np.loadtxt(lias.folder / "lias_fast_mocap.tum")
    t_s = table["t_ns"].to_numpy() * 1e-9
    yaw = np.unwrap(Rotation.from_quat(truth[:, 4:8]).as_euler("ZYX")[:, 0])
    off = wrap_angle(table["yaw_rad"].to_numpy() - np.interp(t_s, truth[:, 0], yaw))
    assert np.degrees(np.std(off)) < 5.0
    assert outcome.metrics["ate_rmse_m"]["value"] < 0.040
    assert outcome.metrics["uwb_coverage_95"]["value"] > 0.9
    fixes, ranges = (pq.read_table(outcome.run / f"{name}.parquet").to_pandas() for name in ("fixes", "ranges"))
    assert set(fixes["tag"]) == set(ranges["tag"]) == {0, 1, 2}
    assert len(ranges) == 323_514
    assert np.isfinite(ranges["predicted_m"]).all()
    assert any("tags 0, 1, 2 are one body" in line for line in lines)
    assert any("heading from the lever arms of the tags" in line for line in lines)


@pytest.mark.parametrize(
    ("levers_m", "words"),
    [
        ([(0, 0), (0, 0), (0, 0)], "have the same lever arm"),
        ([(-0.1423, -0.0689), (0.1402, -0.0750), (0.1451, 0.2034)], "m from its lever arm"),
    ],
)
def test_lever_arms_that_are_not_those_of_the_trolley(lias, tmp_path, levers_m, words):
    _, lines = run(lias, tmp_path / "run", config_of(lias, levers_m), duration_s=20.0)
    assert any(words in line for line in lines)


def test_tags_of_the_table_that_never_range_and_tags_without_a_role(lias, tmp_path):
    config = config_of(lias, lias.levers_m.tolist())
    config.uwb.tags.append(config.uwb.tags[0].model_copy(update={"id": 9}))
    _, lines = run(lias, tmp_path / "silent", config, duration_s=5.0)
    assert any("tags with a role in [[uwb.tags]] that never range: 9" in line for line in lines)
    config.uwb.tags.clear()
    _, lines = run(lias, tmp_path / "without", config, duration_s=10.0)
    assert any("tags without a role: 2; not used" in line for line in lines)
    assert any('below [uwb]: tags = [{id = 0, role = "robot", x_m = 0.0' in line for line in lines)
