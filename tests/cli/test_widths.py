"""What every command that prints a table promises of terminals of any width, whatever names a recording has."""

from __future__ import annotations

import importlib
import shutil
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from rich.cells import cell_len

from quadlog.results.studies.sweep import SweepRow
from tests.cli.conftest import FOLLOW
from tests.lab.runs import change, change_json
from tests.lab.strangers import Log, Room, instants_s, ns

LONG, WIDE, RED = "/a_topic/of_sixty_characters".ljust(60, "x"), "/機器人/位置".ljust(34, "測"), "/red\x1b[31m/pose"
NAME, OTHER = "walk".ljust(60, "y"), "測".ljust(20, "距")
LINES = {
    "info": ("info LOG", 0, (LONG, WIDE, "/red\N{REPLACEMENT CHARACTER}[31m/pose")),
    "metrics": ("metrics A", 0, (NAME, "uwb_residual_m")),
    "metrics of two": ("metrics A B", 0, (NAME, OTHER)),
    "metrics --explain": ("metrics A --explain uwb_residual_m", 0, (NAME, "worst, at least")),
    "check": ("check A --expect bounds.toml", 4, (NAME, "following_distance_mean_m")),
    "diff": ("diff A B", 4, ("topics.base_frame", LONG[1:], OTHER)),
    "compare-planners": (
        "compare-planners MAP --start-cell 0,0 --goal-cell 3,0 --planner ia_star_bounded",
        0,
        (NAME, "ia_star_bounded"),
    ),
    "sweep": (f"sweep LOG --set topics.map_frame={NAME},{OTHER}", 0, (NAME, OTHER, "topics.map_frame")),
    "simulate": ("simulate PATH --controller kinematic --no-plots -o walks --seeds 2 --jobs 1", 0, (NAME,)),
    "survey": ("survey FOLLOW --anchor-height 2", 0, ("left out in 40 columns", "z is as given")),
    "tables": ("tables", 0, (LONG, WIDE)),
}
"""Arguments, exit code, and what has to stand there whole, whatever the width."""
WORDS = {"LOG": NAME, "A": f"runs/{NAME}", "B": f"runs/{OTHER}", "MAP": f"{NAME}.map", "PATH": f"{NAME}.csv"}
WORDS["FOLLOW"] = FOLLOW[0]
SLOW = (
    *("pipelines.info.describe_recording", "results.diff.diff_runs", "pipelines.survey.survey_recording"),
    *("pipelines.simulation.simulate.simulate", "pipelines.comparison.compare.compare"),
)


@pytest.fixture(scope="module")
def place(tmp_path_factory, follow):
    """A folder with a recording, two runs that differ, a map, a path and bounds."""
    folder, log = tmp_path_factory.mktemp("widths"), Log()
    for t_s in instants_s(2.0, 20):
        log.odometry(ns(t_s), Room(6.0).at(t_s), LONG)
        for topic in (WIDE, RED):
            log.pose(ns(t_s), Room(6.0).at(t_s), topic)
        log.tf(ns(t_s), NAME, OTHER, Room(6.0).at(t_s))
    log.write(folder / NAME)
    for name in (NAME, OTHER):
        run = shutil.copytree(follow, folder / "runs" / name)
    change(run, "poses", x_m=lambda x_m: x_m + 0.25 * (np.arange(len(x_m)) == 3))
    change_json(run / "run.json", config__topics__base_frame=LONG[1:])
    (folder / "bounds.toml").write_text("[default]\nfollowing_distance_mean_m = { max = 0.5 }\n")
    (folder / f"{NAME}.map").write_text("type octile\nheight 3\nwidth 4\nmap\n....\n.@@.\n....\n")
    (folder / f"{NAME}.csv").write_text("0,0\n1,0\n1.4,0.3\n")
    return folder


@pytest.fixture
def computed_once(monkeypatch):
    """What takes long gives at every width what it gave at the first one; sweep and tables give what they might."""

    def once(do, given):
        return lambda *words, **flags: given[0] if given else given.append(do(*words, **flags)) or given[0]

    for name in SLOW:
        module, do = f"quadlog.{name}".rsplit(".", 1)
        monkeypatch.setattr(f"{module}.{do}", once(getattr(importlib.import_module(module), do), []))
    values = dict.fromkeys(("following_distance_mean_m", "heading_rmse_rad", "cross_track_rmse_m"), 0.25)
    rows = [
        SweepRow({"topics.map_frame": name}, 0, name, 0, "", {key: at + value for key, value in values.items()})
        for at, name in enumerate((NAME, OTHER))
    ]
    ended = SimpleNamespace(failure_lines=lambda *_: [], exit_code=0)
    monkeypatch.setattr("quadlog.pipelines.batch.sweep.sweep", lambda *_: (rows, ended))
    monkeypatch.setattr("quadlog.pipelines.executor.pool.prepare_workers", lambda: None)
    table = SimpleNamespace(name="t", title=f"{LONG} {WIDE} of {RED}", rows=[1], reproduced="3 of 4 reproduce")
    monkeypatch.setattr("quadlog.pipelines.tables.make_tables.make_tables", lambda *_, **__: [table])


@pytest.mark.parametrize("name", LINES)
def test_tables_fit_every_terminal_and_names_stay_whole(name, place, computed_once, monkeypatch, quadlog):
    """No line is wider than the terminal, but one of a single word; without a terminal tables are as in 80 columns."""
    (line, code, names), printed = LINES[name], {}
    monkeypatch.chdir(place)
    for width in (40, 80, 200, None):
        monkeypatch.delenv("COLUMNS") if width is None else monkeypatch.setenv("COLUMNS", str(width))
        monkeypatch.setattr(sys.stdout, "isatty", lambda width=width: width is not None)
        done = quadlog(*(WORDS.get(word, word) for word in line.split()))
        assert (done.code, "Traceback" in done.err, "\x1b" in done.out) == (code, False, False), done.err
        assert [each for each in names if each not in done.out and (width == 40 or "40" not in each)] == []
        lines = [each.strip().replace("--set ", "--set=") for each in done.out.splitlines()]
        assert [each for each in lines if cell_len(each) > (width or 1e9) and " " in each] == []
        printed[width] = done.out.split()
    assert printed[None] == printed[80]
