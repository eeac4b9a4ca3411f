"""Stages are given the configuration that their keys name: whatever is configured, they need nothing else of it."""

from __future__ import annotations

from dataclasses import replace

import pytest

from quadlog.config.file import load_config
from quadlog.pipelines.executor.progress import Silent
from quadlog.pipelines.replay import replay

NO_WALK = "simulation.controller=none"
TAGS = "uwb.tags=[{id=0, role='robot', x_m=-0.07}, {id=1, role='person', height_m=1.3}]"
CONFIGURATIONS = {
    "kinematic": (None, "plan", ["simulation.controller=kinematic"]),
    "fpmw": (None, "control", ["pursuit.rate_hz=50.0", "simulation.disturbances.push_n=60.0"]),
    "fpm": (None, "control", ["simulation.controller=fpm", "simulation.swing=foot_curve", "grid.extent=run"]),
    "odometry": (None, "control", ["topics.position=odometry", "topics.target=ahead", "grid.memory=scan", NO_WALK]),
    "fixed": (None, "control", ["topics.position=fixed", "topics.target=fixed", "lidar.level=false", NO_WALK]),
    "lidar": (None, "plan", ["topics.position=lidar", "topics.target=ahead", "grid.dilation=body"]),
    "causal": (None, "map", ["uwb.smooth=false", "uwb.method=huber", "uwb.odometry=true", "lidar.odometry=true"]),
    "tags": (None, "map", [TAGS, "smoothing.enabled=false", "lidar.mount.z_m=0.5"]),
    "papers'": ("paper", "control", [NO_WALK]),
    "papers' filter": ("paper", "filter", []),
}


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_a_stage_needs_nothing_that_it_is_not_given(name, fixtures, follow_request, tmp_path):
    preset, until, sets = CONFIGURATIONS[name]
    config = load_config(fixtures / "follow.toml", sets, {}, preset=preset)
    request = follow_request(tmp_path / "run", duration_s=0.5, until=until)
    assert replay(replace(request, config=config, draws=False, plots=False), Silent()).exit_code == 0
