"""What info, init and a replay to the map make of odd logs: a row for each way in which a good log is made odd."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from quadlog.cli.main import run as run_cli
from quadlog.geometry import wrap_angle
from quadlog.results.tables import read_table
from quadlog.storage.formats.ros_map import read_rosmap
from tests.lab import odd
from tests.lab.odd import good, with_ranges
from tests.lab.strangers import Log, Room, ns

ROOM_M, MOST_OFF_M, MOST_TURNED_RAD = 6.0, 0.06, np.radians(2.0)
RANGES = tuple(f"/uwb/tag_0/anchor_{anchor}" for anchor in odd.ANCHORS_M)
LONG = "/camera/aligned_depth_to_color/compressedDepth/of/the/front/" + "\u76f8\u673a" + "/image_raw"


class Odd(NamedTuple):
    """The changes to a log, and what must come out.

    source: of `poses`, whose positions and map must be true; None where none is due. says, never: in what a replay
    prints; says_of_info: in what `info` prints. damage: of the written file. code: of the replay; info_code: of info
    and init. real_s: where the poses' clock is not the walk's, how much later it is, by seconds of the walk.
    """

    changes: tuple[odd.Change, ...]
    source: str | None = "odometry"
    code: int = 0
    says: tuple[str, ...] = ()
    never: tuple[str, ...] = ()
    says_of_info: tuple[str, ...] = ()
    settings: tuple[str, ...] = ()
    damage: Callable[[Path], None] | None = None
    info_code: int = 0
    walls: bool = True
    config: str = ""
    later_s: Callable[[np.ndarray], np.ndarray] = np.zeros_like


UWB = {"source": "uwb", "config": odd.ANCHORS_TOML, "settings": ("topics.position=uwb",)}
ROWS = {
    "good": Odd((good,), never=("warning: header", "lost:")),
    "good-by-uwb": Odd((with_ranges,), **UWB),  # type: ignore[arg-type]
    # frames
    "frame-of-the-scanner": Odd((good, odd.of_sensor("lidar_link", (0.3, 0.1, np.pi / 2))), never=("lidar_link",)),
    "frame-unknown": Odd((good, odd.of_sensor("camera_pose", (0.0, 0.0, 0.0), known=False)), says=("camera_pose",)),
    # several senders
    "two-robots": Odd(
        (good, odd.by_tf("/robot1"), odd.renamed("/scan", "/robot1/scan"), odd.other_robot("/robot2/tf")),
        source="tf",
        says=("/robot2/tf",),
    ),
    "two-senders": Odd((good, odd.by_tf(), odd.other_robot("/tf")), source="tf", says=("two nodes send odom to",)),
    # clocks
    "scans-half-a-second-behind": Odd((good, odd.stamped(-0.5, "/scan")), says=("--stamp log",), walls=False),
    "scans-two-seconds-behind": Odd((good, odd.stamped(-2.0, "/scan")), says=("--stamp",)),
    "scans-a-day-ahead": Odd((good, odd.stamped(86400.0, "/scan")), source=None, says=("--stamp log",), code=1),
    "all-a-year-behind": Odd(
        (good, odd.stamped(-365 * 86400.0)), never=("--stamp log",), later_s=lambda t_s: np.full_like(t_s, -365 * 86400)
    ),
    "ranges-without-stamps": Odd(
        (with_ranges, odd.unstamped(*RANGES), odd.stamped(-2.0, "/odom", "/scan")),
        says=("--stamp",),
        **UWB,  # type: ignore[arg-type]
    ),
    "latched-pose": Odd((good, odd.latched("/amcl_pose", 24.0)), never=("no measured position",)),
    "bursts": Odd((good, odd.in_bursts(0.5, "/odom"))),
    "pause-of-20-s": Odd(
        (good, odd.paused(20.0)),
        code=3,
        says=("no measured position",),
        later_s=lambda t_s: np.where(t_s < odd.SECONDS / 2, 0.0, 20.0),
    ),
    "logs-of-two-days": Odd(
        (good, odd.paused(86400.0)), code=3, later_s=lambda t_s: np.where(t_s < odd.SECONDS / 2, 0.0, 86400.0)
    ),
    # values
    "ranges-twice": Odd((with_ranges, odd.repeated(1_000_000, *RANGES)), **UWB),  # type: ignore[arg-type]
    "ranges-beyond-their-limits": Odd(
        (with_ranges, odd.limited(0.1, 50.0, 60.0, 0.5)),
        says=("max_range",),
        **UWB,  # type: ignore[arg-type]
    ),
    "ranges-below-their-limits": Odd(
        (with_ranges, odd.limited(0.5, 50.0, 0.4, 0.3)),
        says=("min_range",),
        **UWB,  # type: ignore[arg-type]
    ),
    "ranges-in-cm": Odd(
        (with_ranges, odd.in_unit(100.0)), source="odometry", says=("unit",), config=odd.ANCHORS_TOML, walls=True
    ),
    # names and files
    "long-and-wide-names": Odd((good, odd.beside(LONG), odd.beside("/" + "x" * 60)), says_of_info=("/" + "x" * 60,)),
    "nothing": Odd((good, odd.only()), source=None, code=1, says_of_info=("no topics",)),
    "nothing-of-use": Odd((odd.beside("/chatter"),), source=None, code=1, says_of_info=("chatter",)),
    "cut": Odd((good,), damage=odd.cut, code=3, info_code=3, says=("lost:",)),
    "flipped": Odd((good,), damage=odd.flipped, code=3, info_code=3, says=("lost:",)),
}


@pytest.mark.parametrize("name", ROWS)
def test_of_an_odd_log_all_that_is_said_is_true(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    row, room, log = ROWS[name], Room(ROOM_M), Log()
    for change in row.changes:
        change(log, room)
    path, config = log.write(tmp_path / "log.mcap", chunk_size=20_000), tmp_path / "quadlog.toml"
    if row.damage is not None:
        row.damage(path)

    def type_in(*words: str) -> tuple[int, str]:
        code = run_cli([words[0], str(path), *words[1:]])
        done = capsys.readouterr()
        assert "Traceback" not in done.out + done.err
        return code, done.out + done.err

    code, said = type_in("info")
    assert code == row.info_code, said
    assert all(text in said for text in row.says_of_info), said
    code, said = type_in("init", "-o", str(config))
    assert code == row.info_code, said
    config.write_text(config.read_text() + row.config)
    settings = [word for each in row.settings for word in ("--set", each)]
    runs = tmp_path / "runs"
    code, said = type_in("replay", "-c", str(config), "--until", "map", "--no-plots", "-o", str(runs), *settings)
    assert code == row.code, said
    assert all(text in said for text in row.says), said
    assert not any(text in said for text in row.never), said
    if row.source is not None:
        _check_truth(runs / "log", row, room)


def _check_truth(run: Path, row: Odd, room: Room) -> None:
    """Positions and headings are those of the walk, and what is occupied is a wall."""
    poses = read_table(run, "poses")
    assert set(poses["source"]) == {row.source}
    walk_s = np.arange(0.0, odd.SECONDS, 0.001)
    t_s = np.interp((poses["t_ns"] - ns(0.0)) * 1e-9, walk_s + row.later_s(walk_s), walk_s)
    true = np.array([room.at(each) for each in t_s])
    off_m = np.hypot(poses["x_m"] - true[:, 0], poses["y_m"] - true[:, 1])
    assert np.sqrt(np.mean(off_m**2)) < MOST_OFF_M
    if row.source != "uwb":
        assert np.abs(wrap_angle(poses["yaw_rad"] - true[:, 2])).max() < MOST_TURNED_RAD
    if row.walls:
        drawn = read_rosmap(run / "map.yaml")
        at, column = np.nonzero(drawn.blocked)
        cells_m = drawn.origin_m + drawn.cell_m * (np.column_stack([column, at]) + 0.5)
        assert (room.distance_m(cells_m) < 0.2).mean() > 0.95
        assert len(cells_m) > 100
