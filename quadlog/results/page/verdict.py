"""What came out of a run, in a few plain sentences from its saved files, with alarms that need no configuration."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, TypeGuard

import numpy as np

from quadlog.config.controllers import COMMAND
from quadlog.positioning.unlocated import MOST_UNLOCATED
from quadlog.results.page.blocks import Sentence
from quadlog.results.run import Run
from quadlog.results.scenes import SCALE_95, STANDS_M, columns_of
from quadlog.results.text import STATES, State, bounds_of, count, is_alarming, label_of, percent, sig
from quadlog.results.view import GAP_S, in_gaps, rows_within

if TYPE_CHECKING:
    from pandas import DataFrame

STEP_M, STEP_NOISES = 0.1, 8.0
"""The length of a walk is that of steps of at least this size, and of so many times the track's noise."""
NOISE_OVER_S = 0.35
"""Noise is what third differences over this time hold; those of a walk are small."""
FEWEST_ERRORS = 3.0
"""With fewer independent errors a log says nothing of its bound, unless it is grossly wrong."""
_SOURCES = {"uwb": "UWB ranges", "pose": "a pose topic", "legs": "the legs' joints", "lidar": "scan matching",
            "gnss": "satellite fixes", "twist": "integrated velocities", "file": "a trajectory file"}  # fmt: skip
"""In words; others are as they are."""


def verdict(run: Run) -> list[Sentence]:
    """The sentences for which the run has data, worst first."""
    found = [*_recorded(run), *_simulated(run), *_positions(run), *_bounds(run), *_losses(run)]
    return sorted(found, key=lambda sentence: STATES.index(sentence.state))


def status(run: Run) -> tuple[str, State]:
    """The run in a word: the worst of its sentences, and how many need a look."""
    found = verdict(run)
    bad = sum(sentence.state == "bad" for sentence in found)
    warn = sum(sentence.state == "warn" and sentence.subject not in ("Recording", "Positions") for sentence in found)
    warn += len(matters(run))  # of which those sentences have the first
    warnings = f", {warn} warning{'s' * (warn > 1)}" if warn else ""
    if bad:
        return f"{bad} thing{'s' * (bad > 1)} to look at{warnings}", "bad"
    return f"usable{warnings}", "warn" if warn else "good"


LITTLE = 0.05
"""A warning of a smaller share of anything is information."""
_SHARE = re.compile(r"\b(\d+) of (\d+) |\bof (\d+) \S+, (\d+) ")
_LACKING = ("stopped after position: no topic is fit to be the lidar", "no ground is found, as in a 2-D scan",
            "no ground was seen", "no target: nothing is planned", ": 1 stamp from outside of the log")  # fmt: skip
"""What a log does not have, or a part left out for it: what there is can be used as it is."""


def matters(run: Run) -> list[str]:
    """The warnings that change what a reader may use: not what a log lacks, nor what holds of little of it."""
    kept = []
    for warning in run.record.warnings:
        found = _SHARE.search(warning)
        part, whole = sorted(map(int, filter(None, found.groups()))) if found else (1, 1)
        if part > LITTLE * whole and not any(words in warning for words in _LACKING):
            kept.append(warning)
    return kept


def walked_m(track: DataFrame) -> float:
    """Length of a track with seconds, x_m and y_m, without its gaps and without what noise adds."""
    rows = track.dropna(subset=["x_m", "y_m"])
    seconds, places = rows["seconds"].to_numpy(), rows["x_m"].to_numpy() + 1j * rows["y_m"].to_numpy()
    if len(rows) < 2:
        return 0.0
    steps_s = np.diff(seconds)
    lag = rows_within(steps_s, NOISE_OVER_S)
    third_m = np.abs(places[3 * lag :] - 3 * places[2 * lag : -lag] + 3 * places[lag : -2 * lag] - places[: -3 * lag])
    # Of white noise of each axis their variance is 20 times its; the median of a Rayleigh variable is √(2 ln 2) stds.
    noise_m = float(np.median(third_m)) / math.sqrt(40 * math.log(2)) if len(third_m) else 0.0
    least_m, length_m = max(STEP_M, STEP_NOISES * noise_m), 0.0
    for part in np.split(places, np.flatnonzero(in_gaps(steps_s)) + 1):
        last, walked = part[0], 0.0
        for place in part.tolist():
            if (step_m := abs(place - last)) >= least_m:
                walked, last = walked + step_m, place
        length_m += walked + abs(part[-1] - last) * (walked > 0)
    return length_m


def _recorded(run: Run) -> Iterator[Sentence]:
    poses, target, plans = run.table("poses"), run.table("target"), run.table("plans")
    if run.simulated:
        return
    if poses is None and not any(stage.name == "position" for stage in run.record.stages):
        yield Sentence("Recorded walk", "Positions were not computed (--until ingest).")
        return
    walk = "By its positions, which are not to be trusted, the robot" if _implausible(run) else "The robot"
    state: State = "bad" if _implausible(run) else "good"
    if poses is None or set(poses["source"].unique()) == {"fixed"}:
        fixed = "" if poses is None else ": the robot is fixed at the origin"
        text, state = f"No source gave positions of the robot{fixed}.", "bad"
    elif max(float(np.ptp(poses[name].dropna())) for name in ("x_m", "y_m")) < STANDS_M:
        text = f"{walk} stayed within {STANDS_M:g} m for {sig(_lasted_s(poses))} s."
    else:
        did = "followed its target for" if _follows(target) else "walked"
        length_m, lasted_s = walked_m(poses), _lasted_s(poses)
        speed = f" ({sig(length_m / lasted_s, 2)} m/s)" if lasted_s else ""
        text = f"{walk} {did} {sig(length_m)} m in {sig(lasted_s)} s{speed}."
    yield Sentence("Recorded walk", text, state)
    if poses is not None:
        yield from _missing(run, poses)
    if plans is not None:
        failed = int((~plans["found"]).sum())
        every = f"All {count(len(plans))} replans" if len(plans) > 1 else "The only replan"
        words = f"{count(failed)} of {count(len(plans))} replans found no path." if failed else f"{every} found a path."
        yield Sentence("Planning", words, "bad" if failed > 0.1 * len(plans) else "warn" if failed else "good")


def _follows(target: DataFrame | None) -> TypeGuard[DataFrame]:
    """Whether the target is one that moves by itself, not the robot's own future."""
    return target is not None and bool(set(target["source"].unique()) - {"ahead", "fixed"})


def _implausible(run: Run) -> list[str]:
    """Why no robot can have walked the track; nothing of one that a robot can."""
    return [loss.detail for loss in run.record.losses if loss.cause == "implausible positions"]


def _lasted_s(poses: DataFrame) -> float:
    """How long there are positions, without the gaps."""
    steps_s = np.diff(poses["seconds"].to_numpy())
    return float(steps_s[~in_gaps(steps_s)].sum())


def _missing(run: Run, poses: DataFrame) -> Iterator[Sentence]:
    """How long the log goes on without a measured position."""
    missing_s = run.record.counts.get("unlocated_ms", 0) * 1e-3
    if set(poses["source"].unique()) == {"fixed"} or missing_s <= 0 or run.record.recorded_s <= 0:
        return
    share = missing_s / run.record.recorded_s
    steps_s = np.diff(np.sort(poses["seconds"][poses["x_m"].notna() & poses["y_m"].notna()].to_numpy()))
    gaps_s = steps_s[steps_s > GAP_S]
    words = f"No position for {sig(missing_s, 2)} s ({percent(share, 2)} of the log)"
    if len(gaps_s):
        words += f"; {count(len(gaps_s))} gap{'s' * (len(gaps_s) > 1)}, the longest {sig(float(gaps_s.max()), 2)} s"
    yield Sentence("Gaps", f"{words}.", "bad" if share > MOST_UNLOCATED else "warn")


def _simulated(run: Run) -> Iterator[Sentence]:
    control, contacts, clearances = (run.table(name) for name in ("control", "contacts", "clearances"))
    if control is None:
        return
    commanded = run.config.simulation.controller == COMMAND
    recorded = "by the log's commands" if commanded else "on the recorded maps"
    where = f"along {run.record.options['course']}" if run.simulated else recorded
    states: list[State] = ["good" if np.ptp(control["seconds"]) >= 1 else ""]  # too short to judge
    fell = control["fallen"].any()
    ends = ("lateral_drift_m", "completion_time_s")
    short = run.simulated and not fell and run.metrics.keys().isdisjoint(ends)
    how = " and did not reach its end" if short else " without a fall"
    how = f" and fell at {control['seconds'][control['fallen']].min():.1f} s" if fell else how
    states += ["bad"] * bool(fell or short)
    text = f"The simulated robot walked {sig(walked_m(control))} m {where}{how}"
    if commanded and (apart_m := run.metric("eta_time_m")) is not None:
        text += f"; it was {sig(apart_m, 2)} m away from the logged robot on average"
    if contacts is not None and (~contacts["collision"] & (contacts["seconds"] <= control["seconds"].min())).any():
        text += "; it starts inside an obstacle of the map"
        states.append("warn")
    hits = [] if contacts is None else contacts["seconds"][contacts["collision"]].tolist()
    clearance_m = run.metric("clearance_min_m")
    if hits:
        text += f"; it touched obstacles {len(hits)} ×, first at {min(hits):.1f} s"
    elif clearance_m is not None:
        inside, away = f"inside an obstacle by up to {sig(-clearance_m, 2)} m", f"{sig(clearance_m, 2)} m away"
        text += f"; {inside if clearance_m < 0 else f'nearest obstacle {away}'}"
        states += ["warn"] * _alarms(run, "clearance_min_m")
    states += ["bad"] * bool(hits or (clearance_m is not None and clearance_m < 0))
    outside = 0.0 if clearances is None else float(clearances["clearance_m"].isna().mean())
    if outside > 0:
        text += f"; outside of the recorded maps for {percent(outside, 2)} of the time"
        states.append("warn")
    yield Sentence("Simulated walk", f"{text}.{_meaning(run, control, clearances)}", min(states, key=STATES.index))


BEHIND_M = 0.5
"""A distance to the target that grows by less is not worth a word."""


def _meaning(run: Run, control: DataFrame, clearances: DataFrame | None) -> str:
    """That the simulated robot falls behind the recorded one, which had the same target."""
    poses, target = run.table("poses"), run.table("target")
    if poses is None or clearances is None or not _follows(target) or np.ptp(control["seconds"]) < 1:
        return ""
    away_m = [poses[axis] - np.interp(poses["seconds"], target["seconds"], target[axis]) for axis in ("x_m", "y_m")]
    walks = [of[np.isfinite(of)] for of in (clearances["target_distance_m"].to_numpy(), np.hypot(*away_m).to_numpy())]
    tenths = [max(len(of) // 10, 1) for of in walks]
    if not all(map(len, walks)):
        return ""
    first_m, theirs_first_m = (float(np.median(of[:tenth])) for of, tenth in zip(walks, tenths, strict=True))
    last_m, theirs_last_m = (float(np.median(of[-tenth:])) for of, tenth in zip(walks, tenths, strict=True))
    if last_m - first_m - (theirs_last_m - theirs_first_m) < BEHIND_M:
        return ""
    ours, theirs = (sig(walked_m(of) / max(_lasted_s(of), 1e-9), 2) for of in (control, poses))
    apart = f"{sig(first_m, 2)} m from its target at first, {sig(last_m, 2)} m in the end"
    behind = f" It falls behind the recorded robot ({ours} and {theirs} m/s)"
    return f"{behind}: {apart}, where the recorded robot is {sig(theirs_last_m, 2)} m from it."


def _positions(run: Run) -> Iterator[Sentence]:
    poses = run.table("poses")
    if run.simulated or poses is None or set(poses["source"].unique()) == {"fixed"}:
        return
    source = Counter(poses["source"].tolist()).most_common(1)[0][0]
    text, wrong = f"From {_SOURCES.get(source, source)}", False
    error_m, aligned_m = run.metric("ate_rmse_m"), run.metric("ate_aligned_rmse_m")
    bound_m, coverage = _bound_m(run), run.metric("uwb_coverage_95")
    if error_m is not None:
        text += f", {sig(error_m, 2)} m (rms) off the reference"
    elif aligned_m is not None:
        text += f", {sig(aligned_m, 2)} m (rms) off the reference once aligned with it"
    if bound_m is not None:
        text += f", within {sig(bound_m, 2)} m in 95 of 100 cases by its bound"
    if coverage is not None:
        text += f", which holds the truth for {percent(coverage)} of the time"
    seldom, unlike = _alarms(run, "uwb_coverage_95"), _alarms(run, "uwb_nees")
    if seldom or unlike:
        nees = run.metric("uwb_nees") or math.nan
        text += f" (NEES {sig(nees, 2)}, 2 is consistent)" * unlike
        wide = not seldom and nees < 1
        text += ": the bound is wider than needed" if wide else ": do not trust the bound"
        wrong = not wide
    elif (seen := run.metrics["uwb_nees"].independent if "uwb_nees" in run.metrics else None) and seen < FEWEST_ERRORS:
        few = f"about {seen:.0f} independent errors" if seen >= 1.5 else "one constant error"
        text += f" ({few}: too little to judge the bound)"
    if error_m is aligned_m is coverage is run.metric("uwb_rmse_m") is None:
        text += "; there is no reference to compare with"
    doubts, warning = _implausible(run), _first(_of_positions(run))
    state: State = "bad" if wrong or doubts else "warn" if warning else "good"
    first = f"{warning[0].upper()}{warning[1:]}. " if warning else ""
    yield Sentence("Positions", f"{first}{'; '.join([text, *doubts])}.", state)


_POSITIONS = ("heading std", "of fixes", "epochs", "surfaces that face one way", "no pose is given", "jump")
"""What a warning of positions says."""


def _of_positions(run: Run) -> list[str]:
    """The warnings that matter for positions, where there is a sentence of positions."""
    poses = run.table("poses")
    said = not run.simulated and poses is not None and set(poses["source"].unique()) != {"fixed"}
    return [of for of in matters(run) if said and any(words in of for words in _POSITIONS)]


def _first(warnings: Sequence[str]) -> str:
    """The first warning, and of how many."""
    of = f" (1 of {count(len(warnings))})" if len(warnings) > 1 else ""
    return f"{warnings[0].rstrip('.')}{of}" if warnings else ""


def _alarms(run: Run, name: str) -> bool:
    """Whether the metric is unusual and has no bound in [expect]."""
    of = run.metrics.get(name)
    return of is not None and name not in bounds_of(run) and is_alarming(name, of)


def _bound_m(run: Run) -> float | None:
    """Half the longer axis of the poses' 95 % ellipse, median over the run; None where none is claimed."""
    table = run.table("pose_uncertainty")
    if table is None:
        return None
    xx, xy, yy = columns_of(table, "cov_xx_m2 cov_xy_m2 cov_yy_m2")
    major_m2 = (xx + yy) / 2 + np.hypot(xx - yy, 2 * xy) / 2
    known = major_m2[np.isfinite(major_m2)]
    return float(SCALE_95 * np.sqrt(max(np.median(known), 0.0))) if len(known) else None


def _bounds(run: Run) -> Iterator[Sentence]:
    bounds = bounds_of(run)
    bad = [name for name, bound in bounds.items() if bound.state == "bad"]
    broken = [label_of(name) + " (not measured)" * (run.metric(name) is None) for name in bad]
    if broken:
        do = "do" if len(broken) > 1 else "does"
        yield Sentence("Expected", f"{len(broken)} of {len(bounds)} bounds {do} not hold: {', '.join(broken)}.", "bad")
    elif bounds:
        yield Sentence("Expected", f"All {len(bounds)} bounds hold." if len(bounds) > 1 else "The bound holds.", "good")


def _losses(run: Run) -> Iterator[Sentence]:
    causes, placed = list(dict.fromkeys(loss.cause for loss in run.record.losses)), _of_positions(run)
    warnings = [of for of in matters(run) if of not in placed]
    lost = f"Part was lost ({', '.join(causes[:3])})." if causes else "" if run.simulated else "Nothing was lost."
    warning = f"Warning: {_first(warnings)}." if warnings else ""
    if words := f"{lost} {warning}".strip():
        yield Sentence("Recording", words, "bad" if causes else "warn" if warnings else "good")
