from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import foxglove.layouts as official
import numpy as np
import pytest

from quadlog.errors import NotARun
from quadlog.results.foxglove.derived_mcap import CELLS, ERRORS, write_derived
from quadlog.results.foxglove.layout import write_layout
from quadlog.results.run.tables import TABLES, write_table

PANELS = {"3D": official.ThreeDeeConfig, "Plot": official.PlotConfig, "RosOut": official.LogConfig}
TOPICS = {
    "foxglove.Grid": official.BaseRendererGridTopicSettings,
    "foxglove.PointCloud": official.BaseRendererPointCloudTopicSettings,
    "foxglove.PoseInFrame": official.BaseRendererPoseTopicSettings,
    "foxglove.SceneUpdate": official.BaseRendererSceneUpdateTopicSettings,
}
SCHEMAS = {"map": "Grid", "scan": "PointCloud", "pose": "PoseInFrame", "target": "PoseInFrame", "fix": "PoseInFrame"}


def placed(node: Any) -> list[str]:
    return [node] if isinstance(node, str) else placed(node["first"]) + placed(node["second"])


def knows(kind: Any, config: dict[str, Any]) -> None:
    """Every key is one that the SDK's own class of this panel or topic writes."""
    assert set(config) - {"foxglovePanelTitle"} <= set(kind()._to_dict()), kind


def test_panels_show_what_is_there_with_settings_that_foxglove_has(tiny_run: Path, derived: Any) -> None:
    layout = json.loads(write_layout(tiny_run).read_bytes())
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    panels = layout["configById"]
    assert placed(layout["layout"]) == ["3D!scene", "Plot!expanded", "Plot!error", "RosOut!log"]
    assert set(panels) == set(placed(layout["layout"]))
    for name, config in panels.items():
        knows(PANELS[name.partition("!")[0]], config)
    scene = panels["3D!scene"]
    knows(official.ThreeDeeCameraState, scene["cameraState"])
    assert set(scene["topics"]) <= set(derived)
    assert {"/quadlog/uwb/fix/0", "/quadlog/uwb/fix/1", "/quadlog/map", "/quadlog/scan"} <= set(scene["topics"])
    for topic, settings in scene["topics"].items():
        words = topic.split("/")
        schema = next((SCHEMAS[word] for word in words if word in SCHEMAS), "SceneUpdate")
        knows(TOPICS[f"foxglove.{schema}"], settings)
    assert panels["RosOut!log"]["topicToRender"] in derived


def test_plots_are_of_numbers_that_the_messages_have(tiny_run: Path, derived: Any) -> None:
    panels = json.loads(write_layout(tiny_run).read_bytes())["configById"]
    shown = [each for name in panels if name.startswith("Plot!") for each in panels[name]["paths"]]
    assert sorted(each["label"] for each in shown) == sorted([*CELLS, *ERRORS])
    for each in shown:
        knows(official.PlotSeries, each)
        topic, _, field = each["value"].partition(".")
        assert isinstance(getattr(derived[topic][0][1], field), float)


def test_the_whole_walk_is_in_view(tiny_run: Path) -> None:
    camera = json.loads(write_layout(tiny_run).read_bytes())["configById"]["3D!scene"]["cameraState"]
    # A quarter circle of 3 m from the origin, and a target 2 m further in x: from (0, 0) to (5, 3).
    assert camera["targetOffset"] == pytest.approx([2.5, 1.5, 0])
    assert camera["distance"] == 10
    write_table(
        tiny_run / "target.parquet",
        TABLES["target"],
        {"t_ns": [0, 1], "x_m": [100.0, np.nan], "y_m": [-20.0, 1e9], "source": "topic"},
    )
    camera = json.loads(write_layout(tiny_run).read_bytes())["configById"]["3D!scene"]["cameraState"]
    assert camera["targetOffset"] == pytest.approx([50, -8.5, 0])
    assert camera["distance"] == pytest.approx(130)


@pytest.mark.parametrize(
    ("gone", "left"),
    [
        (["plans"], ["3D!scene", "Plot!error", "RosOut!log"]),
        (["plans", "control"], ["3D!scene", "RosOut!log"]),
    ],
)
def test_what_a_run_has_not_is_not_shown(tiny_run: Path, gone: list[str], left: list[str]) -> None:
    for name in gone:
        (tiny_run / f"{name}.parquet").unlink()
    write_derived(tiny_run)
    layout = json.loads(write_layout(tiny_run).read_bytes())
    assert placed(layout["layout"]) == left == sorted(layout["configById"])


def test_a_bare_run_is_one_scene(tmp_path: Path) -> None:
    pose = {"t_ns": [0], "x_m": np.nan, "y_m": np.nan, "yaw_rad": np.nan, "source": "uwb"}
    pose |= dict.fromkeys(("z_m", "roll_rad", "pitch_rad"), np.nan)
    write_table(tmp_path / "poses.parquet", TABLES["poses"], pose)
    write_derived(tmp_path)
    layout = json.loads(write_layout(tmp_path).read_bytes())
    assert layout["layout"] == "3D!scene"
    assert list(layout["configById"]["3D!scene"]["topics"]) == ["/quadlog/pose"]


def test_a_missing_or_damaged_file_is_named(tiny_run: Path) -> None:
    (tiny_run / "derived.mcap").write_bytes(b"no mcap")
    with pytest.raises(NotARun, match=r"derived\.mcap: is damaged"):
        write_layout(tiny_run)
    (tiny_run / "derived.mcap").unlink()
    with pytest.raises(NotARun, match=r"has no derived\.mcap"):
        write_layout(tiny_run)
