from __future__ import annotations

import json
from pathlib import Path

import pytest

from quadlog.errors import NotARun
from quadlog.results.compare.check_text import check_json, check_text
from quadlog.results.compare.expectations import parse_expectations
from quadlog.results.compare.run_check import RunCheck, check_run, read_or_explain, read_saved_run
from quadlog.results.run.tables import METRIC_NAMES


def held(run: Path, text: str) -> RunCheck:
    return check_run(read_saved_run(run), parse_expectations(text, "bounds.toml", METRIC_NAMES))


@pytest.mark.parametrize(
    ("bound", "reason"),
    [
        ("{ max = 0.123 }", ""),
        ("{ min = 0.123 }", ""),
        ("{ min = 0.1, max = 0.2 }", ""),
        ("{ max = 0.12299999 }", "0.123 is above max 0.12299999"),
        ("{ min = 0.12300001 }", "0.123 is below min 0.12300001"),
    ],
)
def test_bounds_include_their_ends(tiny_run: Path, bound: str, reason: str) -> None:
    check = held(tiny_run, f"[recordings.walk]\neta_m = {bound}")
    assert check.holds is (reason == "")
    assert [each.reason for each in check.checks] == [reason]


def test_an_absent_metric_does_not_hold_and_is_never_0(tiny_run: Path) -> None:
    check = held(tiny_run, "[default]\nate_rmse_m = { max = 1 }\neta_m = { max = 1 }")
    assert not check.holds
    assert [(each.value, each.holds) for each in check.checks] == [(None, False), (0.123, True)]
    assert "the run does not have this metric" in check.checks[0].reason
    (bound, _) = check_json([check])[0]["bounds"]
    assert "value" not in bound
    assert "absent" in check_text([check])


@pytest.mark.parametrize("text", ["", "[recordings.other]\neta_m = { max = 1 }", "[recordings.walk]"])
def test_a_run_of_which_nothing_is_expected_does_not_pass(tiny_run: Path, text: str) -> None:
    check = held(tiny_run, text)
    assert not check.holds
    assert check_text([check]) == (
        f"{tiny_run}: no bounds are expected of this run; add [recordings.walk] or [default]\n"
    )


def test_a_walk_goes_by_its_course_and_by_its_seed(tiny_run: Path) -> None:
    record = json.loads((tiny_run / "run.json").read_text())
    seed = tiny_run.parent / "line-fpmw" / "seed-003"
    seed.parent.mkdir()
    tiny_run.rename(seed)
    assert read_saved_run(seed).names == ("seed-003",)  # a recording of that name
    record["options"] = {"course": "line", "seed": 3}
    (seed / "run.json").write_text(json.dumps(record))
    assert read_saved_run(seed).names == ("line-fpmw", "line-fpmw/seed-003")
    assert read_saved_run(seed.rename(seed.parent / "baseline")).names == ("baseline",)


def test_a_run_is_named_by_where_it_really_is(tiny_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tiny_run)
    assert read_saved_run(Path()).names == ("walk",)


def test_what_cannot_be_read_is_explained(tiny_run: Path) -> None:
    (tiny_run / "metrics.json").write_text("{")
    with pytest.raises(NotARun):
        read_saved_run(tiny_run)
    check = read_or_explain(tiny_run)
    assert isinstance(check, RunCheck)
    assert not check.holds
    assert check.error is not None
    assert "metrics.json: is damaged" in check.error
    assert check_json([check])[0]["error"] == check.error


def test_json_says_what_was_expected_and_found(tiny_run: Path) -> None:
    check = held(tiny_run, "[default]\neta_m = { min = 0.5 }\nfallen = { max = 0 }")
    assert check_json([check]) == [
        {
            "run": str(tiny_run),
            "name": "walk",
            "holds": False,
            "bounds": [
                {"metric": "eta_m", "min": 0.5, "value": 0.123, "holds": False, "reason": "0.123 is below min 0.5"},
                {"metric": "fallen", "max": 0.0, "value": 0.0, "holds": True},
            ],
        }
    ]


def test_a_name_that_needs_quotes_gets_them(tiny_run: Path) -> None:
    odd = tiny_run.rename(tiny_run.parent / 'a.b "c"')
    line = check_text([held(odd, "")])
    (key,) = parse_expectations(line[line.index("[") : line.index("]") + 1], "x", METRIC_NAMES).recordings
    assert key == 'a.b "c"'
