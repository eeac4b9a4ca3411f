from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from quadlog.cli.info import dilution_lines, link_table, reach_lines, tag_lines
from quadlog.cli.main import run

FIXTURES = Path(__file__).parents[2] / "fixtures"
LINK: dict[str, Any] = {
    "tag": 0,
    "anchor": 3,
    "n": 584,
    "residual_m": 0.241,
    "residual_median_m": -0.0736,
    "bias_m": -0.023,
    "bias_std_m": 0.087,
    "bias_applied": False,
    "why_not": "known to 0.09 m only",
    "nlos_share": 0.0749,
    "weak_first_path_share": None,
}
REACH: dict[str, Any] = {"topic": "/uwb", "tag": 2, "anchor": 3, "n": 10, "range_min_m": 1.0, "range_max_m": 7.256}
TAG: dict[str, Any] = {
    "tag": 2,
    "role": "robot",
    "epochs": 600,
    "fixes": 590,
    "too_few_ranges": 8,
    "degenerate": 2,
    "hdop_median": 1.034,
    "ellipse_major_median_m": 0.199,
    "ellipse_minor_median_m": 0.156,
    "reference": "/truth",
    "fix_error": {"rmse_m": 0.342, "bias_x_m": 0.003, "bias_y_m": -0.153, "share_in_ellipse": 0.599},
    "track_error": None,
}


def test_a_rejected_bias_says_why_and_an_applied_one_that_it_is() -> None:
    _, (rejected, applied) = link_table([LINK, LINK | {"bias_applied": True, "why_not": ""}])
    assert rejected == [
        "0",
        "3",
        "584",
        "0.241",
        "-0.074",
        "7.5 %",
        "-0.023 +- 0.087",
        "not applied: known to 0.09 m only",
    ]
    assert applied[-1] == "applied"
    _, (none,) = link_table([LINK | {"bias_m": None, "bias_std_m": None, "why_not": "calibration is off"}])
    assert none[-2:] == ["", "not applied: calibration is off"]


def test_first_paths_have_a_column_only_where_a_radio_tells() -> None:
    columns, _ = link_table([LINK])
    assert "weak path" not in columns
    columns, rows = link_table([LINK, LINK | {"weak_first_path_share": 0.125}])
    assert [row[columns.index("weak path")] for row in rows] == ["", "12.5 %"]
    assert {len(row) for row in rows} == {len(columns)}


def test_a_tag_says_what_it_claims_and_what_the_reference_says() -> None:
    own, error = tag_lines(TAG)
    assert own == (
        "tag 2 (robot): 590 fixes in 600 epochs (8 with too few ranges, 2 degenerate); "
        "median HDOP 1.03, median 95 % semi-axes 0.199 x 0.156 m"
    )
    assert error == "  fixes against /truth: RMSE 0.342 m, bias (+0.003, -0.153) m, 59.9 % in their 95 % ellipses"


def test_a_tag_without_fixes_claims_nothing() -> None:
    nothing = {"role": None, "fixes": 0, "too_few_ranges": 600, "degenerate": 0, "hdop_median": None, "fix_error": None}
    (line,) = tag_lines(TAG | nothing)
    assert line == "tag 2: 0 fixes in 600 epochs (600 with too few ranges)"


def test_the_map_has_north_up_and_its_axes_at_the_cells_middles() -> None:
    hdop = [[0.7, 1.0, None], [12.0, 0.75, 2.0]]
    lines = list(
        dilution_lines({"origin_x_m": -3.0, "origin_y_m": 1.5, "cell_m": 1.5, "tag_height_m": 0.6, "hdop": hdop})
    )
    assert lines[0].startswith("HDOP")
    assert lines[1:] == [
        " y m",
        "3.75 |   >10  0.75  2.00",
        "2.25 |  0.70  1.00     -",
        "     +------------------",
        " x m   -2.25 -0.75  0.75",
    ]


def test_info_prints_all_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["info", str(FIXTURES / "follow.mcap"), "-c", str(FIXTURES / "follow.toml")]) == 0
    out, _ = capsys.readouterr()
    assert out.count("not applied: ") == 8
    for words in (
        "tag 0 (robot): 598 fixes in 600 epochs",
        "track against /truth/robot/pose: RMSE",
        "HDOP",
        " y m",
        " x m",
    ):
        assert words in out, words
    assert max(len(line) for line in out[out.index("HDOP (") :].splitlines()) < 80


def test_a_log_whose_tags_hear_too_little_still_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    """Of three anchors of the configuration only one is in the log."""
    anchors = (
        "[{id=0, x_m=1.0, y_m=1.0, z_m=1.15}, {id=11, x_m=9.0, y_m=0.0, z_m=1.0}, {id=12, x_m=0.0, y_m=9.0, z_m=1.0}]"
    )
    assert run(["info", str(FIXTURES / "follow.mcap"), "--set", f"uwb.anchors={anchors}"]) == 0
    out, _ = capsys.readouterr()
    assert "with too few ranges" in out
    assert "residual m" not in out


def test_each_link_has_a_line_until_there_are_too_many() -> None:
    none = REACH | {"anchor": 4, "range_min_m": None, "range_max_m": None}
    assert list(reach_lines([REACH, none])) == [
        "  /uwb  tag 2  anchor 3  10 ranges  1.00..7.26 m",
        "  /uwb  tag 2  anchor 4  10 ranges  none a number",
    ]
    assert len(list(reach_lines([REACH] * 40))) == 40
    *lines, last = reach_lines([REACH] * 43)
    assert len(lines) == 40
    assert last == "  and 3 more links, all of them in --json"
