"""The verdict, the cards and the bounds of the report, from saved runs."""

from __future__ import annotations

import re
from collections.abc import Callable
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.page.metric_cards import THEMES, metric_themes
from quadlog.results.page.report import write_report
from quadlog.results.page.verdict import verdict, walked_m
from quadlog.results.plots.run_data import RunData

ChangeJson = Callable[[Path, dict[str, Any]], None]


def lines(run: Path) -> dict[str, str]:
    return {line.subject: " ".join(each.text for each in line.sentences) for line in verdict(RunData(run))}


def alarms(run: Path) -> list[str]:
    return [each.text for line in verdict(RunData(run)) for each in line.sentences if each.alarm]


def test_the_lines_say_what_happened_where_it_touched_and_how_good_positions_were(tiny_run: Path) -> None:
    # A quarter circle of 3 m in 3.9 s; one replan of 40 fails; of two contacts one is a collision.
    assert lines(tiny_run) == {
        "Walk": "The robot followed its target over 4.71 m in 3.9 s (1.2 m/s). 1 of 40 replans found no path. "
        "Re-simulated on the recorded maps, it walked 4.7 m without a fall. "
        "Part of the recording was lost: crc (below).",
        "Contact": "1 contact of the simulated body, at 1.8 s near (2.1, 0.3) m: the robot cut a corner of its plan. "
        "Not counted: 1 × an obstacle that first appeared inside the body.",
        "Positions": "From UWB ranges, ±0.24 m (95 % bound). The recording has no reference to check them against.",
    }
    assert len(alarms(tiny_run)) == 3


def test_each_sentence_only_where_its_data_is(tiny_run: Path, change_json: ChangeJson) -> None:
    for name in ("control", "contacts", "clearances", "plans", "target", "pose_uncertainty"):
        (tiny_run / f"{name}.parquet").unlink()
    change_json(tiny_run / "run.json", {"losses": []})
    assert lines(tiny_run) == {
        "Walk": "The robot walked 4.71 m in 3.9 s (1.2 m/s). Nothing was lost to damage; 1 warning below.",
        "Contact": "Not checked: the walk was not re-simulated on recorded maps.",
        "Positions": "From UWB ranges. The recording has no reference to check them against.",
    }
    assert alarms(tiny_run) == []


def test_a_walk_that_falls_or_does_not_arrive_says_so(tiny_walk: Path, change: Callable[..., None]) -> None:
    start = "The simulated robot walked 4.71 m in 3.98 s (1.2 m/s) along the course line"
    assert lines(tiny_walk) == {"Walk": f"{start} and did not reach its end."}
    change(tiny_walk, "control", fallen=np.arange(200) >= 150)
    assert alarms(tiny_walk) == [f"{start} and fell at 3.0 s."]


def test_a_metric_has_a_colour_only_where_a_bound_is_expected(tiny_run: Path, change_json: ChangeJson) -> None:
    page = write_report(tiny_run).read_text()
    assert not re.findall(r'<div class="(?:good|warn|bad)"', page)
    saved = {"value": 0.1, "n": 200, "unit": "m", "low": 0.05, "high": 0.2}
    change_json(tiny_run / "metrics.json", {"eta_m": saved, "sigma_m": saved, "collisions": saved | {"value": 2}})
    expect = {"eta_m": {"max": 0.15}, "sigma_m": {"min": 0.01, "max": 1.0}, "collisions": {"max": 0.0}}
    change_json(tiny_run / "run.json", {"config.expect": expect | {"ate_rmse_m": {"max": 1.0}}})
    shown = {each.name: each for theme in metric_themes(RunData(tiny_run)) for each in theme.card if each.state}
    # Within its bound with all of its interval; with its value alone; not; not measured.
    states = {name: each.state for name, each in shown.items()}
    assert states == {"collisions": "bad", "eta_m": "warn", "sigma_m": "good", "ate_rmse_m": "bad"}
    assert shown["eta_m"].interval == "0.05 to 0.2"
    assert shown["collisions"].interval == ""  # a count of events
    assert "2 of 4 expected bounds do not hold." in alarms(tiny_run)
    assert sorted(re.findall(r'<div class="(good|warn|bad)"', write_report(tiny_run).read_text())) == [
        *("bad", "bad", "good", "warn")
    ]


def test_without_expected_bounds_a_page_warns_of_what_is_unusual(
    tiny_run: Path, change: Callable[..., None], change_json: ChangeJson
) -> None:
    usual, before = {"uwb_coverage_95": 0.95, "uwb_nees": 2.0, "clearance_min_m": 0.3}, alarms(tiny_run)

    def warned(values: dict[str, float]) -> set[str]:
        for name, value in (usual | values).items():
            change_json(tiny_run / "metrics.json", {name: {"value": value, "n": 9, "unit": CATALOGUE[name].unit}})
        new = [text for text in alarms(tiny_run) if text not in before]
        themes = metric_themes(RunData(tiny_run))
        states = {each.name: each.state for theme in themes for each in theme.card if each.state}
        assert set(states.values()) <= {"warn"}
        assert len(new) == len(states)
        assert all(any(name in text for text in new) for name in states)
        return set(states)

    assert warned({}) == set()
    assert warned({"uwb_coverage_95": 0.84, "uwb_nees": 4.1}) == {"uwb_coverage_95", "uwb_nees"}
    assert warned({"uwb_nees": 0.9, "clearance_min_m": -0.2}) == {"uwb_nees", "clearance_min_m"}
    assert "Check clearance_min_m: nearest obstacle is \u22120.2 m, usual is at least 0.05 m." in alarms(tiny_run)
    change_json(tiny_run / "run.json", {"config.expect": {"uwb_nees": {"min": 0.5}, "clearance_min_m": {"min": -1.0}}})
    assert alarms(tiny_run) == before
    loss = {"cause": "positions", "detail": "38% of 4.0 s have no measured position"}
    change_json(tiny_run / "run.json", {"counts.unlocated_ms": 1520, "losses": [loss]})
    assert "38 % of the log has no measured position." in alarms(tiny_run)


def test_every_metric_has_one_theme() -> None:
    themed = [name for metrics in THEMES.values() for name in metrics]
    assert sorted(themed) == sorted(CATALOGUE)


def test_names_in_the_verdict_are_text(tiny_run: Path, change: Callable[..., None], change_json: ChangeJson) -> None:
    hostile = "<script>alert(1)</script>"
    change(tiny_run, "poses", source=hostile)
    change(tiny_run, "contacts", cause=hostile)
    change_json(tiny_run / "metrics.json", {hostile: {"value": 1.0, "n": 1, "unit": hostile}})
    page = write_report(tiny_run).read_text()
    assert hostile not in page
    assert f"From the topic {hostile}" in unescape(page)


@given(st.floats(0.2, 50), st.integers(0, 2**32 - 1))
def test_noise_of_positions_adds_little_to_the_length_of_a_walk(length_m: float, seed: int) -> None:
    noise_m = np.random.default_rng(seed).normal(0, 0.005, (2, 2000))
    x_m = np.linspace(0, length_m, 2000) + noise_m[0]
    x_m[5] = np.nan
    assert walked_m(x_m, noise_m[1]) == pytest.approx(length_m, rel=0.05, abs=0.15)


def test_a_robot_outside_of_the_maps_is_not_called_safe(tiny_run: Path, change: Callable[..., None]) -> None:
    (tiny_run / "contacts.parquet").unlink()
    change(tiny_run, "clearances", clearance_m=lambda m: np.where(np.arange(len(m)) % 2 == 0, np.nan, 0.5))
    assert lines(tiny_run)["Contact"].startswith("The simulated robot touched nothing; its nearest obstacle was 0.50 m")
    assert lines(tiny_run)["Contact"].endswith("50 % of the time it was outside of the recorded maps.")
    change(tiny_run, "clearances", clearance_m=np.nan)
    assert lines(tiny_run)["Contact"].startswith("Not known")
