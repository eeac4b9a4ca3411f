"""What the first sentences of a page say, and when they warn."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from markupsafe import escape
from pandas import DataFrame

from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.page.run_page import cards, metric_table, write_run_page
from quadlog.results.page.verdict import status, verdict, walked_m
from quadlog.results.run import Run
from quadlog.results.text import STATES
from tests.lab.runs import along_course, change, change_json, remove, until_ingest, with_gap, with_one_scan


def measured(independent: float | None = None, **values: float) -> Callable[[Path], None]:
    """metrics.json with these values, of so many independent errors."""

    def write(run: Path) -> None:
        seen = {} if independent is None else {"independent": independent}
        units = {name: CATALOGUE[name].unit for name in values}
        saved = {name: {"value": of, "n": 900, "unit": units[name]} | seen for name, of in values.items()}
        change_json(run / "metrics.json", **saved)

    return write


def expecting(**bounds: dict[str, float]) -> Callable[[Path], None]:
    return lambda run: change_json(run / "run.json", config__expect=bounds)


def lasting(seconds: float, lost_ms: int, gap_s: float = 0.0) -> Callable[[Path], None]:
    """The second half of the positions comes later, and the log goes on."""

    def move(run: Path) -> None:
        change(run, "poses", t_ns=lambda t_ns: t_ns + int(gap_s * 1e9) * (np.arange(40) >= 20))
        change_json(run / "run.json", recorded_s=seconds, counts__unlocated_ms=lost_ms)

    return move


def fallen(run: Path) -> None:
    along_course(run)
    change(run, "control", fallen=np.arange(200) >= 150)


def outside(run: Path) -> None:
    change(run, "clearances", clearance_m=np.where(np.arange(200) % 2 == 0, np.nan, 0.5))
    remove(run, "contacts")


def standing(run: Path) -> None:
    """In a box of less than a metre it goes to and fro."""
    change(run, "poses", x_m=lambda x_m: 0.4 * np.sin(np.arange(len(x_m))), y_m=0.0)


def untrusted(run: Path) -> None:
    loss = {"cause": "implausible positions", "detail": "positions jump 7 times", "topic": "", "count": None}
    change_json(run / "run.json", losses=[loss])


def begins_inside(run: Path) -> None:
    first_ns = int(Run(run).table("control")["t_ns"].min())  # type: ignore[index]
    change(run, "contacts", t_ns=first_ns, collision=False)


CASES = {
    "as it is": ([], "Recorded walk", "good", "The robot followed its target for 4.71 m in 3.9 s (1.2 m/s)."),
    "collision": ([], "Simulated walk", "bad", "touched obstacles 1 ×, first at 1.8 s"),
    "failed replan": ([], "Planning", "warn", "1 of 40 replans found no path."),
    "lost": ([], "Recording", "bad", "Part was lost (crc). Warning: no heading source: yaw is the course."),
    "position did not run": ([until_ingest], "Recorded walk", "", "Positions were not computed (--until ingest)."),
    "heading": ([lambda run: change_json(run / "run.json", warnings=["heading std is 7.4 degrees"])],
                "Positions", "warn", "Heading std is 7.4 degrees. From UWB ranges"),
    "lost only": ([lambda run: change_json(run / "run.json", warnings=["heading std is 7.4 degrees"], losses=[])],
                  "Recording", "good", "Nothing was lost."),
    "stands": ([standing], "Recorded walk", "good", "The robot stayed within 1 m for 3.9 s."),
    "a walk without its gap": ([with_gap], "Recorded walk", "good", "in 3.8 s (1.2 m/s)."),
    "no walk": ([untrusted], "Recorded walk", "bad", "By its positions, which are not to be trusted, the robot"),
    "positions of no walk": ([untrusted], "Positions", "bad", "; positions jump 7 times."),
    "begins inside": ([begins_inside], "Simulated walk", "warn", "; it starts inside an obstacle of the map"),
    "goes inside": ([lambda run: remove(run, "contacts"), measured(clearance_min_m=-0.18)], "Simulated walk", "bad",
                    "; inside an obstacle by up to 0.18 m."),
    "gap": ([with_gap], "Gaps", "bad", "1 gap, the longest 30 s"),
    "short gap": ([lasting(4.4, 0, 0.5)], "Gaps", None, ""),
    "log goes on": ([lasting(60.0, 56_100)], "Gaps", "bad", "No position for 56 s (94 % of the log)."),
    "coverage": ([measured(uwb_coverage_95=0.65, uwb_nees=5.1)], "Positions", "bad",
                 "the truth for 65 % of the time (NEES 5.1, 2 is consistent): do not trust the bound."),
    "bound too wide": ([measured(uwb_coverage_95=1.0, uwb_nees=0.4)], "Positions", "good", "wider than needed"),
    "one error": ([measured(1.0, uwb_coverage_95=0.6, uwb_nees=5.1)], "Positions", "good",
                  "for 60 % of the time (one constant error: too little to judge the bound)."),
    "two errors": ([measured(2.2, uwb_coverage_95=1.0, uwb_nees=0.5)], "Positions", "good", "about 2 independent err"),
    "one gross error": ([measured(1.0, uwb_coverage_95=0.0, uwb_nees=9.0)], "Positions", "bad", "do not trust"),
    "twenty errors": ([measured(20.0, uwb_coverage_95=0.8, uwb_nees=2.8)], "Positions", "good", "of the time."),
    "claimed at half": ([measured(20.0, uwb_coverage_95=0.6, uwb_nees=6.0)], "Positions", "bad", "do not trust"),
    "as claimed": ([measured(uwb_coverage_95=0.95, uwb_nees=2.0)], "Positions", "good", "for 95 % of the time."),
    "NEES is expected": ([measured(uwb_nees=5.1), expecting(uwb_nees={"max": 6.0})], "Positions", "good", "From UWB"),
    "clearance": ([lambda run: remove(run, "contacts"), measured(clearance_min_m=0.02)], "Simulated walk", "warn",
                  "nearest obstacle 0.02 m away"),
    "falls behind": ([lambda run: change(run, "clearances", target_distance_m=np.linspace(2, 4, 200))],
                     "Simulated walk", "bad", "first, 3.9 m in the end, where the recorded robot is 2 m from it."),
    "keeps its distance": ([], "Simulated walk", "bad", "first at 1.8 s."),
    "outside of the maps": ([outside], "Simulated walk", "warn", "outside of the recorded maps for 50 % of the time"),
    "fall": ([fallen], "Simulated walk", "bad", "along line and fell at 3.0 s."),
    "not arrived": ([along_course], "Simulated walk", "bad", "did not reach its end"),
    "one scan": ([with_one_scan], "Simulated walk", "", "walked 0 m"),
    "one bound": ([expecting(eta_m={"max": 0.2})], "Expected", "good", "The bound holds."),
    "not measured": ([expecting(eta_m={"max": 0.2}, ate_rmse_m={"max": 1}, uwb_nees={"max": 3})], "Expected", "bad",
                     "2 of 3 bounds do not hold: position error (not measured), NEES of the track"),
}  # fmt: skip


FLAT = "287 of 287 scans: no ground is found, as in a 2-D scan; heights are measured from base as configured"
PLANE = "no ground was seen: the re-simulated robot walks on a plane"
MOUNT = "lidar.mount is neither configured nor in tf: the lidar is taken to sit in base, looking forward"
NO_LIDAR = "stopped after position: no topic is fit to be the lidar"
NO_TARGET = "no target: nothing is planned; set topics.target to uwb, ahead, fixed or a pose topic"
JUDGED = {
    "fixture": ("usable", ["tag 0: of 600 epochs, 2 with fewer than three ranges give no fix"]),
    "many epochs without a fix": ("usable, 1 warning", ["tag 0: of 600 epochs, 60 with fewer than three ranges"]),
    "jackal": ("usable", [NO_LIDAR]),
    "cleanest_avoid": ("usable", ["5 of 269 scans: fewer than 20 points on the ground or on obstacles", FLAT, PLANE]),
    "anlam_hallway": ("usable, 2 warnings", ["590 of 881 scans show surfaces that face one way", MOUNT, FLAT, PLANE]),
    "everardo_obst": ("usable, 1 warning", [FLAT, PLANE], 0.0045),
    "evo_tf_example, husky_le, traj_toolkit": ("usable", [NO_LIDAR]),
    "gruhl_laser": ("usable, 3 warnings", [
        "13 of 867 scans have fewer than 10 returns or match nothing seen before: no pose is given there",
        "853 of 867 scans show surfaces that face one way", MOUNT, FLAT, PLANE,
        "13 scans are not in the map: no pose within 0.5 s of them"]),
    "latched_pose": ("usable", ["/amcl_pose: 1 stamp from outside of the log (latched, or wrong)", NO_LIDAR]),
    "lidarme": ("usable, 2 warnings", ["366 of 485 scans show surfaces that face one way", MOUNT, FLAT, NO_TARGET]),
    "obst_test": ("usable", [FLAT, NO_TARGET]),
    "philip_nav": ("usable, 2 warnings", [MOUNT, FLAT, PLANE], 0.018),
    "ron_map": ("usable, 1 warning", [MOUNT, FLAT, PLANE]),
    "shohei_data": ("usable, 1 warning", ["7 of 301 scans are not levelled: tilted by more than 40 degrees",
                    "13 of 301 scans: fewer than 20 points on the ground or on obstacles", FLAT, PLANE], 0.012),
    "topic_of_32_characters": ("usable, 1 warning", [
        "no position was found: the robot is taken to stand at the origin; lidar: no topic is fit", NO_LIDAR]),
    "lias_fast": ("usable, 1 warning", ["/mocap: 145 of 17234 messages have the stamp of another; they are dropped",
                                        "heading std is 7.6 degrees, an error of 1.33 m at 10 m", NO_LIDAR]),
}  # fmt: skip
"""What a log's warnings, and the clearance of its simulated walk, let a reader use, judged by hand."""


@pytest.mark.parametrize("log", JUDGED)
def test_a_run_is_amber_only_for_what_changes_its_use(tiny_run: Path, log: str) -> None:
    remove(tiny_run, "contacts")
    change(tiny_run, "plans", found=True)
    words, warnings, *clearance_m = JUDGED[log]
    measured(clearance_min_m=clearance_m[0] if clearance_m else 0.3)(tiny_run)
    change_json(tiny_run / "run.json", losses=[], warnings=warnings)
    assert status(Run(tiny_run))[0] == words
    if log == "fixture":
        assert escape(warnings[0]) in write_run_page(Run(tiny_run)).read_text()


@pytest.mark.parametrize("case", CASES)
def test_a_sentence_says_what_is_true_and_warns_where_it_must(tiny_run: Path, case: str) -> None:
    changes, subject, state, words = CASES[case]
    for act in changes:
        act(tiny_run)
    lines = {line.subject: line for line in verdict(Run(tiny_run))}
    states = [line.state for line in lines.values()]
    assert states == sorted(states, key=STATES.index)
    if state is None:
        assert subject not in lines
    else:
        assert words in lines[subject].text.replace("\u202f", " ")
        assert lines[subject].state == state


def test_all_bounds_that_were_not_measured_are_shown(tiny_run: Path) -> None:
    measured(uwb_coverage_95=0.6, eta_m=0.123)(tiny_run)
    names = ("ate_rmse_m", "uwb_rmse_m", "uwb_nees", "uwb_nis", "uwb_bias_m", "eta_m")
    expecting(**{name: {"max": 0.2} for name in names})(tiny_run)
    run = Run(tiny_run)
    shown = {name.text: value for _, numbers in cards(run) for name, value in numbers}
    missing = [CATALOGUE[name].label for name in names[:-1]]
    assert {label for label, one in shown.items() if one.text == "not measured"} == set(missing)
    assert {shown[label].state for label in missing} == {"bad"}
    assert shown[CATALOGUE["eta_m"].label].state == "good"
    rows = {row[1].text: row for row in metric_table(run).rows}
    assert "95 % interval" not in {column.name for column in metric_table(run).columns}  # no value has one
    assert rows["uwb_coverage_95"][2].state == "warn"  # unusual, without any bound
    assert all((rows[name][2].text, rows[name][2].state) == ("not measured", "bad") for name in names[:-1])


@given(
    st.floats(4, 60) | st.just(0.0), st.sampled_from([0.0, 0.005, 0.05, 0.15]), st.integers(0, 2**32 - 1), st.booleans()
)
def test_noise_of_positions_adds_little_to_the_length_of_a_walk(
    length_m: float, std_m: float, seed: int, bursts: bool
) -> None:
    """Along an arc, for 60 s and with a day between its halves; noise that lasts for some rows, as in matched scans.

    bursts: four rows within 6 ms, as a round of ranges gives them.
    """
    rows = np.arange(1200)
    seconds = rows // 4 / 5 + rows % 4 / 500 if bursts else rows / 20
    share = seconds / seconds[-1]
    noise_m = np.random.default_rng(seed).normal(0, std_m, (2, 1203))
    noise_m = (noise_m[:, :-3] + noise_m[:, 1:-2] + noise_m[:, 2:-1] + noise_m[:, 3:]) / 2
    x_m, y_m = 2 * np.sin(share * length_m / 2) + noise_m[0], 2 * np.cos(share * length_m / 2) + noise_m[1]
    x_m[5] = np.nan
    track = DataFrame({"seconds": seconds + 86400 * (share > 0.5), "x_m": x_m, "y_m": y_m})
    assert walked_m(track) == pytest.approx(length_m, rel=0.1, abs=0.1 if length_m == 0 else 16 * std_m)


def test_a_run_is_given_every_warning_in_its_count(tiny_run: Path) -> None:
    change_json(tiny_run / "run.json", warnings=["a", "b", "c"])
    assert status(Run(tiny_run)) == ("2 things to look at, 4 warnings", "bad")
