"""derived.mcap says what the tables say, in Foxglove's own schemas; the layout shows it."""

from __future__ import annotations

import json
import os
import resource
import shutil
import subprocess
import sys
from operator import itemgetter
from pathlib import Path
from typing import Any

import foxglove.layouts as official
import numpy as np
import pandas as pd
import pytest
from mcap.reader import SeekingReader
from scipy.spatial.transform import Rotation

from quadlog.config.schema import Config
from quadlog.errors import CannotWrite, NotARun
from quadlog.results.arrays import load_maps
from quadlog.results.foxglove import STEP_NS, write_derived
from quadlog.results.record import RunRecord
from quadlog.results.run import Run
from quadlog.results.tables import TABLES, read_table, write_table
from tests.quadlog.results.conftest import decode_mcap

START_NS = 1_700_000_000_123_456_789


def test_messages_are_the_tables_in_time_order(tiny_run: Path, derived: Any) -> None:
    with (tiny_run / "derived.mcap").open("rb") as file:
        stored = [message.log_time for *_, message in SeekingReader(file).iter_messages(log_time_order=False)]
    assert stored == sorted(stored)
    assert stored[0] == START_NS
    for (t_ns, grid), (map_t_ns, origin_m, cells) in zip(derived["/quadlog/map"], load_maps(tiny_run), strict=True):
        assert (t_ns, grid.pose.position.x, grid.pose.position.y) == (map_t_ns, *origin_m)
        assert (grid.column_count, grid.row_stride, grid.cell_stride, grid.cell_size.x) == (50, 50, 1, 0.1)
        np.testing.assert_array_equal(np.frombuffer(grid.data, np.uint8).reshape(60, 50), cells)
    poses, links = pd.DataFrame(read_table(tiny_run, "poses")), read_table(tiny_run, "links")
    for (t_ns, message), row in zip(derived["/quadlog/pose"], poses.itertuples(), strict=True):
        assert t_ns == row.t_ns == message.timestamp.seconds * 10**9 + message.timestamp.nanos
        assert (message.pose.position.x, message.pose.position.y) == (row.x_m, row.y_m)
    frames = [derived[topic][-1][1] for topic in ("/quadlog/tf", "/quadlog/resim/tf")]
    assert [(each.parent_frame_id, each.child_frame_id) for each in frames] == [("map", "base"), ("map", "base_resim")]
    assert derived["/quadlog/uwb/fix/0"][0][1].pose.position.z == 0.6
    for prefix, topic in (("", "/quadlog"), ("resim_", "/quadlog/resim")):
        paths = pd.DataFrame(read_table(tiny_run, f"{prefix}paths"))
        for (t, rows), (t_ns, update) in zip(paths.groupby("t_ns"), derived[f"{topic}/path"], strict=True):
            assert t == t_ns
            points = [(each.x, each.y) for each in update.entities[0].lines[0].points]
            np.testing.assert_array_equal(points, rows[["smooth_x_m", "smooth_y_m"]].dropna())
    ((_, update),) = derived["/quadlog/uwb/anchors"]
    assert [entity.texts[0].text for entity in update.entities] == ["anchor 0", "anchor 1", "anchor 2"]
    at = [entity.spheres[0].pose.position for entity in update.entities]
    np.testing.assert_array_equal([(each.x, each.y, each.z) for each in at],
                                  np.column_stack([links[name][:3] for name in ("x_m", "y_m", "z_m")]))  # fmt: skip


def test_numbers_over_time_are_all_rows_of_the_tables_and_lines_are_the_errors(tiny_run: Path, derived: Any) -> None:
    control, ranges, errors = (pd.DataFrame(read_table(tiny_run, of)) for of in ("control", "ranges", "uwb_errors"))
    walk = {t: values for t, values in derived["/quadlog/resim/values"] if "error_m" in values}
    assert [*walk] == control["t_ns"].tolist()
    assert [of["error_m"] for of in walk.values()] == pytest.approx(control["error_m"], abs=1e-6)
    assert any("clearance_m" in of for _, of in derived["/quadlog/resim/values"])
    sent = {(t, name): value for t, of in derived["/quadlog/uwb/residuals"] for name, value in of.items()}
    rows = ranges.drop_duplicates(["t_ns", "tag", "anchor"]).itertuples()
    wanted = {(of.t_ns, f"tag_{of.tag}_anchor_{of.anchor}_m"): of.range_m - of.predicted_m for of in rows}
    assert sent == pytest.approx(wanted, abs=1e-6)
    own = errors[errors["source"] == "track"].groupby("t_ns").first()
    lengths_m = {t: np.hypot(a.x - b.x, a.y - b.y) for t, update in derived["/quadlog/error"]
                 for a, b in [update.entities[0].lines[0].points]}  # fmt: skip
    assert [*lengths_m.values()] == pytest.approx(np.hypot(own["error_x_m"], own["error_y_m"])[[*lengths_m]])
    speeds = [of["speed_mps"] for _, of in derived["/quadlog/values"] if "speed_mps" in of]
    poses = pd.DataFrame(read_table(tiny_run, "poses"))
    stepped_mps = np.hypot(poses["x_m"].diff(), poses["y_m"].diff()) / (poses["t_ns"].diff() * 1e-9)
    assert np.median(speeds) == pytest.approx(np.nanmedian(stepped_mps), rel=0.2)


def scipys(turn: Any) -> Rotation:
    return Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])


def test_the_same_results_are_the_same_bytes_in_any_process(tiny_run: Path) -> None:
    written = (tiny_run / "derived.mcap").read_bytes()
    script = (
        "import foxglove; foxglove.Channel('/other', message_encoding='json')\n"
        "from quadlog.results.foxglove import write_derived\nfrom quadlog.results.run import Run\n"
        f"write_derived(Run({str(tiny_run)!r}))"
    )
    subprocess.run([sys.executable, "-c", script], check=True, env={**os.environ, "PYTHONHASHSEED": "7"})
    assert (tiny_run / "derived.mcap").read_bytes() == written


def test_a_walk_along_a_course_is_the_robot(tiny_run: Path, tiny_record: RunRecord, tmp_path: Path) -> None:
    shutil.copy(tiny_run / "control.parquet", tmp_path)
    found = decode_mcap(write_derived(Run(tmp_path, tiny_record)))
    control = pd.DataFrame(read_table(tmp_path, "control"))
    control = control[~(control["t_ns"] // STEP_NS).duplicated()]
    frames = [each for _, each in found["/quadlog/tf"]]
    assert {(frame.parent_frame_id, frame.child_frame_id) for frame in frames} == {("map", "base")}
    angles = np.nan_to_num(np.column_stack([control["yaw_rad"], control["pitch_rad"], control["roll_rad"]]))
    turned = Rotation.concatenate([scipys(frame.rotation) for frame in frames])
    assert (Rotation.from_euler("ZYX", angles).inv() * turned).magnitude().max() < 1e-7
    assert "/quadlog/resim/tf" not in found
    assert len(found["/quadlog/resim/pose"]) == len(read_table(tmp_path, "control")["t_ns"]) > len(frames)


@pytest.mark.parametrize("t_ns", [-1, (1 << 32) * 10**9])
def test_what_cannot_be_shown_leaves_no_file(tmp_path: Path, tiny_record: RunRecord, t_ns: int) -> None:
    pose = dict.fromkeys(("x_m", "y_m", "yaw_rad", "z_m", "roll_rad", "pitch_rad"), 0.0)
    write_table(tmp_path / "poses.parquet", TABLES["poses"], {**pose, "t_ns": [t_ns], "source": "uwb"})
    with pytest.raises(NotARun, match="before 1970 or after 2106"):
        write_derived(Run(tmp_path, tiny_record))
    assert sorted(each.name for each in tmp_path.iterdir()) == ["poses.parquet"]


def test_a_full_disk_is_one_error_and_leaves_no_file(
    tiny_run: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, before[1]))
    try:
        with pytest.raises(CannotWrite):
            write_derived(Run(tiny_run), tmp_path / "a.mcap")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert (capfd.readouterr().err, [path.name for path in tmp_path.iterdir()]) == ("", [tiny_run.name])


def test_the_lidar_is_a_frame(tiny_run: Path, tiny_record: RunRecord, tmp_path: Path) -> None:
    mount = {"x_m": 0.2, "y_m": -0.1, "z_m": 0.45, "roll_deg": 10.0, "pitch_deg": -20.0, "yaw_deg": 90.0}
    changed = {"config": Config.model_validate({"lidar": {"mount": mount}})}
    found = decode_mcap(write_derived(Run(tiny_run, tiny_record.model_copy(update=changed)), tmp_path / "a.mcap"))
    ((t_ns, frame),) = found["/quadlog/tf_static"]
    assert (t_ns, frame.parent_frame_id, frame.child_frame_id) == (START_NS, "base", "lidar")
    assert (frame.translation.x, frame.translation.y, frame.translation.z) == (0.2, -0.1, 0.45)
    assert (scipys(frame.rotation).inv() * Rotation.from_euler("ZYX", [90, -20, 10], degrees=True)).magnitude() < 1e-9


PANELS = {"3D": official.ThreeDeeConfig, "Plot": official.PlotConfig}
SETTINGS = {
    "Grid": official.BaseRendererGridTopicSettings,
    "PoseInFrame": official.BaseRendererPoseTopicSettings,
    "SceneUpdate": official.BaseRendererSceneUpdateTopicSettings,
}


def test_the_layout_has_settings_that_foxglove_knows_and_fields_that_the_messages_have(
    tiny_run: Path, derived: Any
) -> None:
    def known(kind: Any, config: dict[str, Any]) -> bool:
        return set(config) - {"foxglovePanelTitle"} <= set(kind()._to_dict())

    def placed(node: Any) -> list[str]:
        return [node] if isinstance(node, str) else placed(node["first"]) + placed(node["second"])

    layout = json.loads((tiny_run / "foxglove-layout.json").read_bytes())
    assert set(layout) == {"configById", "globalVariables", "userNodes", "playbackConfig", "layout"}
    panels = layout["configById"]
    assert sorted(placed(layout["layout"])) == sorted(panels)
    assert all(known(PANELS[name.partition("!")[0]], config) for name, config in panels.items())
    scene = panels["3D!scene"]
    assert known(official.ThreeDeeCameraState, scene["cameraState"])
    assert scene["followTf"] == "base"
    assert {"/quadlog/uwb/fix/0", "/quadlog/uwb/fix/1"} <= set(scene["topics"]) <= set(derived)
    kinds = {topic: SETTINGS[type(derived[topic][0][1]).__name__] for topic in scene["topics"]}
    assert all(known(kinds[topic], settings) for topic, settings in scene["topics"].items())
    plotted = {
        value
        for name, config in panels.items()
        if name[:5] == "Plot!"
        for value in map(itemgetter("value"), config["paths"])
    }
    sent = {
        f"{topic}.{name}"
        for topic, messages in derived.items()
        for _, of in messages
        if isinstance(of, dict)
        for name in of
    }
    assert plotted == sent
    paths = [path for config in panels.values() for path in config.get("paths", ())]
    assert all(set(path) <= set(official.PlotSeries()._to_dict()) for path in paths)
