from __future__ import annotations

from quadlog.results.text.walks import walks_text


def test_one_walk_is_one_row_in_the_units_of_its_heading():
    head, row = walks_text([{"seed": 3, "eta_m": 0.01234, "height_rms_m": 0.0021, "fallen": 0.0}]).splitlines()
    assert head.split("  ") == ["seed", " eta m", "height mm", "falls"]
    assert row.split() == ["3", "0.0123", "2.1", "0"]


def test_mean_and_deviation_are_over_the_walks_that_have_the_metric():
    rows = [
        {"seed": 0, "eta_m": 0.1, "completion_time_s": 20.0, "fallen": 0.0},
        {"seed": 1, "eta_m": 0.3, "fallen": 1.0},
    ]
    lines = [line.split() for line in walks_text(rows).splitlines()]
    assert lines[2] == ["1", "0.3000", "1"]
    assert lines[3] == ["mean", "0.2000", "20.00", "0.50"]
    assert lines[4] == ["std", "0.1414", "0.71"]
