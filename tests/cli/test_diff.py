from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from quadlog.cli.main import run

FIXTURES = Path(__file__).parents[2] / "fixtures"


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A run of the same seconds that sees less of them."""
    folder = tmp_path_factory.mktemp("other")
    recording = [str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml"), "--until", "map"]
    what = ["--duration", "0.5", "-o", str(folder), "--set", "grid.min_height_m=0.3", "--no-plots"]
    assert run(["replay", *recording, *what]) == 0
    return folder / "follow"


def edited(follow, tmp_path, name, change):
    """A copy of the run with another run.json or metrics.json."""
    copy = shutil.copytree(follow, tmp_path / "follow")
    content = json.loads((copy / name).read_text())
    change(content)
    (copy / name).write_text(json.dumps(content))
    return copy


def test_another_seed_alone_is_listed_and_is_no_difference(follow, tmp_path, quadlog):
    same = edited(follow, tmp_path, "run.json", lambda record: record.update(seed=3))
    done = quadlog("diff", follow, same)
    assert (done.code, done.err) == (0, "")
    lines = done.out.splitlines()
    assert lines[2] == "results: the same"
    assert lines[lines.index("seed: differs") + 1] == "    seed  0 | 3 (by 3)"
    assert {"position: the same", "map: the same", "plan: nothing saved"} <= set(lines)


def test_a_difference_is_found_in_its_stage(follow, other, quadlog):
    done = quadlog("diff", follow, other)
    assert done.code == 4
    lines = done.out.splitlines()
    assert lines[2].startswith("results: differ, first in stage map: maps.npz, cells at 0.000 s (t_ns 17672256")
    assert "    grid.min_height_m  0.05 | 0.3 (by 0.25)" in lines
    assert "filter: the same" in lines
    (cells,) = [line for line in lines if line.startswith("        cells")]
    assert "5 rows, the first at 0.000 s" in cells
    assert " | " in cells
    assert "at most " in cells


def test_json_has_all_of_it(follow, other, quadlog):
    done = quadlog("diff", follow, other, "--json")
    assert done.code == 4
    content = json.loads(done.out)
    assert not content["same"]
    assert content["first"]["stage"] == "map"
    assert content["first"]["place"] == {"t_ns": content["start_ns"], "s": 0.0, "keys": {}}
    assert content["origins"]["config"] == [{"key": "grid.min_height_m", "a": 0.05, "b": 0.3, "apart": 0.25}]
    results = {each["name"]: each for each in content["stages"]["map"]}
    assert results["maps.npz"]["columns"][0]["rows"] == 5
    assert [each["same"] for each in content["stages"]["filter"]] == [True, True]


def test_tolerances(follow, tmp_path, quadlog):
    def change(metrics):
        metrics["uwb_residual_m"]["value"] += 1e-6

    copy = edited(follow, tmp_path, "metrics.json", change)
    allowed = ([], ["--tolerance", "2e-6"], ["--relative", "1e-9"], ["--relative", "1e-4"])
    assert [quadlog("diff", follow, copy, *each).code for each in allowed] == [4, 0, 4, 0]


@pytest.mark.parametrize("flag", ["--tolerance", "--relative"])
@pytest.mark.parametrize("value", ["-1", "nan", "inf", "x"])
def test_a_tolerance_is_a_finite_amount(follow, flag, value, refused):
    refused(2, "diff", follow, follow, flag, value)


def test_what_is_no_run_or_damaged_is_named_in_one_line(follow, tmp_path, refused):
    refused(1, "diff", follow, tmp_path / "nothing")
    refused(1, "diff", follow.parent, follow)
    copy = shutil.copytree(follow, tmp_path / "follow")
    (copy / "scans.parquet").write_bytes(b"PAR1")
    assert "scans.parquet" in refused(1, "diff", copy, follow, "--json")


def test_names_from_a_recording_cannot_command_the_terminal(follow, tmp_path, quadlog):
    copy = edited(follow, tmp_path, "run.json", lambda record: record["topics"][0].update(topic="/\x1b[31mred\nline"))
    done = quadlog("diff", copy, follow)
    assert (done.code, "\x1b" in done.out, "red line" in done.out) == (4, False, True)
