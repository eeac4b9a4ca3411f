"""Folders of many replays; the grid of a sweep: values as typed, and what is refused before anything runs."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from quadlog.errors import InvalidConfigValue, UnknownConfigKey, UsageError
from quadlog.pipelines.batch.plan import kept_names
from quadlog.pipelines.batch.sweep import make_grid, split_values
from quadlog.results.find_runs import run_name


@pytest.mark.parametrize(
    ("override", "values"),
    [
        ("planner.name=astar, ia_star", ["astar", "ia_star"]),
        ("a.b=[1, 2],[3,4]", ["[1, 2]", "[3,4]"]),
        ("""a.b="x,y",'z,"'""", ['"x,y"', """'z,"'"""]),
        ("a.b={c=1,d=[2,3]},{}", ["{c=1,d=[2,3]}", "{}"]),
        ("a.b=x=1,y", ["x=1", "y"]),
        *((wrong, None) for wrong in ("planner.name", "=1,2", "a.b=1,,2", "a.b=", "a.b=[1,2", 'a.b="x,y', "a.b=1,")),
    ],
)
def test_commas_inside_brackets_and_quotes_separate_nothing(override, values):
    if values is None:
        with pytest.raises(InvalidConfigValue):
            split_values(override)
    else:
        assert split_values(override)[1] == values


def test_every_combination_has_its_own_configuration_and_folder_whatever_its_values():
    grid = make_grid(None, ["grid.cell_m=0.1,0.2", "uwb.tag_height_m=0.6", "planner.name=astar,ia_star"], range(4, 6))
    assert [each.name for each in grid[1:3]] == [
        "grid.cell_m=0.1,planner.name=astar,seed=005",
        "grid.cell_m=0.1,planner.name=ia_star,seed=004",
    ]
    configs = [each.configured.config for each in grid]
    assert len({(each.grid.cell_m, each.planner.name, each.uwb.tag_height_m) for each in configs}) == len(grid) / 2 == 4
    long = "/" + "x" * 300
    names = [each.name for each in make_grid(None, [f"topics.target=/a/b,/a_b,/A_b,../..,{long}1,{long}2"], [0])]
    assert all(name == run_name(name) and len(name) < 200 for name in names)
    assert len({name.casefold() for name in names}) == 6
    assert make_grid(None, ["topics.target=/a_b,/a/b"], [0])[1].name == names[0]  # it depends on its own values


@pytest.mark.parametrize(
    ("sets", "seeds", "error"),
    [
        (["planner.nme=astar,ia_star"], 1, UnknownConfigKey),
        (["grid.cell_m=0.1,-3"], 1, InvalidConfigValue),
        (["grid.cell_m=0.1,0.10"], 1, UsageError),  # the same configuration twice
        (["grid.cell_m=0.1", "grid.cell_m=0.2"], 1, UsageError),
        (["grid.cell_m=0.1"], 1, UsageError),  # nothing varies
        (["grid.cell_m=0.1,0.2"], 6000, UsageError),  # too many
    ],
)
def test_a_grid_that_makes_no_sense_is_refused(sets, seeds, error):
    with pytest.raises(error):
        make_grid(None, sets, range(seeds))


def replayed(output: Path, recordings: list[Path]) -> dict[Path, str]:
    """What `quadlog replay --resume` would leave of the recordings; returns who would have which folder."""
    names = dict(zip(recordings, kept_names(recordings, output), strict=True))
    for recording, name in names.items():
        record = output / name / "run.json"
        if not record.exists():
            record.parent.mkdir(parents=True)
            record.write_text(json.dumps({"input": {"path": str(recording)}}))
    return names


A, B, C = (Path(f"/season/{each}/rec.mcap") for each in "abc")
ANY = [A, B, C, Path("/x/rec.bag"), Path("/x/rec-2.mcap"), Path("/x/Rec.db3")]


@example([[C, B], [B, A], [A]])
@example([[A], [Path("/x/Rec.db3")], [A, Path("/x/Rec.db3")]])  # which are one folder on some disks
@given(st.lists(st.lists(st.sampled_from(ANY), unique=True), max_size=4))
def test_no_two_share_a_folder_and_none_ever_changes_its_own(tmp_path_factory, batches):
    output = tmp_path_factory.mktemp("runs")
    owners = {}
    for batch in batches:
        names = replayed(output, batch)
        assert len({name.casefold() for name in names.values()}) == len(batch)
        mine = {recording: name for name, recording in owners.items()}
        assert all(names[each] == mine[each] for each in batch if each in mine)
        owners |= {name: each for each, name in names.items() if name not in owners}
