"""What a run came to in three lines, from its saved files: the walk and its losses, contacts, positions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.results.page.metric_cards import bound_words, held_bounds, in_words, missed_alarms, plain_name
from quadlog.results.plots.run_data import STANDS_M, RunData, Table
from quadlog.results.plots.uwb_position import SCALE_95
from quadlog.results.text.numbers import count, short

_STEP_M = 0.1
"""A walk's length is that of steps of at least this size, so that the noise of positions does not add to it."""
_TOLD_CONTACTS = 3
_XY = ("x_m", "y_m")
_SOURCES = {
    "uwb": "UWB ranges",
    "odometry": "odometry",
    "tf": "tf",
    "legs": "the legs' joints",
    "lidar": "matched lidar scans",
    "file": "a trajectory file",
}


@dataclass(frozen=True, slots=True)
class Sentence:
    """A sentence of the verdict. alarm: something went wrong that a reader must not miss."""

    text: str
    alarm: bool = False


@dataclass(frozen=True, slots=True)
class VerdictLine:
    """One line: its subject in a word, and sentences."""

    subject: str
    sentences: Sequence[Sentence]


def verdict(run: RunData) -> list[VerdictLine]:
    """The lines for which the run has data. Raises NotARun for damaged files."""
    return [line for line in (_walk(run), _contacts(run), _positions(run)) if line is not None]


def walked_m(x_m: Float, y_m: Float) -> float:
    """Length of the way through points (N,), in steps of at least _STEP_M; points that are not finite are skipped."""
    known = np.isfinite(x_m) & np.isfinite(y_m)
    points = list(zip(x_m[known].tolist(), y_m[known].tolist(), strict=True))
    if not points:
        return 0.0
    length_m, (last_x, last_y) = 0.0, points[0]
    for x, y in points:
        step_m = ((x - last_x) ** 2 + (y - last_y) ** 2) ** 0.5
        if step_m >= _STEP_M:
            length_m, last_x, last_y = length_m + step_m, x, y
    return length_m


def _walk(run: RunData) -> VerdictLine:
    said = _simulated(run) if run.simulated else _replayed(run)
    return VerdictLine("Walk", [*said, *_bounds(run), *_lost(run)])


def _simulated(run: RunData) -> Iterator[Sentence]:
    course, control, fell_s = run.record.options.get("course"), run.table("control"), _fell_s(run)
    start = f"The simulated robot walked{'' if control is None else f' {_way(control)}'} along the course {course}"
    if fell_s is not None:
        yield Sentence(f"{start} and fell at {fell_s:.1f} s.", alarm=True)
    elif run.metric("completion_time_s") is not None:
        yield Sentence(f"{start} and reached its end.")
    elif run.metric("eta_m") is not None:
        yield Sentence(f"{start} and did not reach its end.", alarm=True)
    else:
        yield Sentence(f"{start}.")


def _replayed(run: RunData) -> Iterator[Sentence]:
    poses, control, plans = run.table("poses"), run.table("control"), run.table("plans")
    if poses is None and run.record.options.get("until") == "ingest":
        yield Sentence("Positions were not asked for (--until ingest).")
    elif poses is None:
        yield Sentence("The recording does not tell where the robot was.")
    elif set(poses["source"]) == {"fixed"}:
        yield Sentence("The recording does not tell where the robot was; it is taken to have stood still.")
    elif all(_width(poses[name]) < STANDS_M for name in _XY):
        yield Sentence(f"The robot moved less than {STANDS_M:g} m in {short(_lasted_s(poses), 2)} s.")
    else:
        yield Sentence(f"The robot {_what_it_did(run)} {_way(poses)}.")
    if plans is not None:
        failed, total = int(np.count_nonzero(~plans["found"])), count(len(plans["found"]))
        words = f"{count(failed)} of {total} replans found no path." if failed else f"All {total} replans found a path."
        yield Sentence(words, alarm=failed > 0)
    if control is not None:
        start = f"Re-simulated on the recorded maps, it walked {walked_m(control['x_m'], control['y_m']):.1f} m"
        if (fell_s := _fell_s(run)) is not None:
            yield Sentence(f"{start} and fell at {fell_s:.1f} s.", alarm=True)
        else:
            yield Sentence(f"{start} without a fall." if run.metric("fallen") is not None else f"{start}.")


def _width(values: Float) -> float:
    """Largest less smallest of values (N,) that are finite; -inf without one."""
    return float(np.nanmax(values, initial=-np.inf) - np.nanmin(values, initial=np.inf))


def _what_it_did(run: RunData) -> str:
    """Whether it followed someone: a target that walks itself, not a point or the robot's own future."""
    target = run.table("target")
    sources = set() if target is None else set(target["source"])
    return "followed its target over" if sources - {"ahead", "fixed"} else "walked"


def _way(track: Table) -> str:
    """Length, duration and mean speed of a table with t_ns, x_m and y_m."""
    length_m, lasted_s = walked_m(track["x_m"], track["y_m"]), _lasted_s(track)
    speed = f" ({short(length_m / lasted_s, 2)} m/s)" if lasted_s > 0 else ""
    return f"{short(length_m, 3) if length_m < 1000 else count(round(length_m))} m in {short(lasted_s, 3)} s{speed}"


def _lasted_s(track: Table) -> float:
    return float(track["t_ns"][-1] - track["t_ns"][0]) / 1e9


def _fell_s(run: RunData) -> float | None:
    """When the simulated robot fell, None where it did not."""
    control = run.table("control")
    if control is None or not control["fallen"].any():
        return None
    return float(run.seconds(control["t_ns"])[np.argmax(control["fallen"])])


def _bounds(run: RunData) -> Iterator[Sentence]:
    held, expected = held_bounds(run)
    if held < expected:
        yield Sentence(f"{expected - held} of {expected} expected bounds do not hold.", alarm=True)
    elif expected:
        yield Sentence(f"All {expected} expected bounds hold.")
    for name, bound in missed_alarms(run).items():
        unit = CATALOGUE[name].unit
        is_what = f"{plain_name(name)} is {in_words(name, run.metrics[name]['value'], unit)}"
        yield Sentence(f"Check {name}: {is_what}, usual is {bound_words(bound, unit)}.", alarm=True)


def _lost(run: RunData) -> Iterator[Sentence]:
    if run.simulated:
        return
    causes = list(dict.fromkeys(loss.cause for loss in run.record.losses))
    if not causes:
        many = len(run.record.warnings)
        told = f"Nothing was lost to damage; {many} warning{'s' * (many > 1)} below." if many else "Nothing was lost."
        yield Sentence(told)
        return
    more = f" and {len(causes) - _TOLD_CONTACTS} more" if len(causes) > _TOLD_CONTACTS else ""
    yield Sentence(f"Part of the recording was lost: {', '.join(causes[:_TOLD_CONTACTS])}{more} (below).", alarm=True)


def _contacts(run: RunData) -> VerdictLine | None:
    clearances, contacts = run.table("clearances"), run.table("contacts")
    if clearances is None and contacts is None:
        if run.simulated or run.table("poses") is None:
            return None
        return VerdictLine("Contact", [Sentence("Not checked: the walk was not re-simulated on recorded maps.")])
    appeared = 0
    if contacts is not None:
        appeared = int(np.count_nonzero(~contacts["collision"]))
        contacts = {name: column[contacts["collision"]] for name, column in contacts.items()}
    if contacts is not None and len(contacts["t_ns"]):
        sentences = [Sentence(_touched(run, contacts), alarm=True)]
    else:
        sentences = [Sentence(_nearest(run, clearances))]
    if appeared:
        sentences.append(Sentence(f"Not counted: {count(appeared)} × an obstacle that first appeared inside the body."))
    return VerdictLine("Contact", sentences)


def _touched(run: RunData, contacts: Table) -> str:
    seconds, total = run.seconds(contacts["t_ns"]).tolist(), len(contacts["t_ns"])
    if total <= _TOLD_CONTACTS:
        rows = zip(seconds, contacts["x_m"], contacts["y_m"], contacts["cause"], strict=True)
        told = "; ".join(f"at {at:.1f} s near ({x:.1f}, {y:.1f}) m: {cause}" for at, x, y, cause in rows)
        return f"{total} contact{'s' * (total > 1)} of the simulated body, {told}."
    causes = ", ".join(f"{many} × {cause}" for cause, many in Counter(contacts["cause"].tolist()).most_common(2))
    return f"{count(total)} contacts of the simulated body from {seconds[0]:.1f} s on, mostly {causes}."


def _nearest(run: RunData, clearances: Table | None) -> str:
    known = np.isfinite(clearances["clearance_m"]) if clearances is not None else np.zeros(0, bool)
    if clearances is None or np.isnan(clearances["clearance_m"]).all():
        return "Not known: the simulated robot was outside of the recorded maps all the time."
    unknown = np.count_nonzero(np.isnan(clearances["clearance_m"])) / len(known)
    outside = f" {short(100 * unknown, 2)} % of the time it was outside of the recorded maps." if unknown else ""
    if not known.any():
        return f"No obstacle was near the simulated robot.{outside}"
    nearest = int(np.argmin(np.where(known, clearances["clearance_m"], np.inf)))
    at_s = float(run.seconds(clearances["t_ns"])[nearest])
    away_m = clearances["clearance_m"][nearest]
    return (
        f"The simulated robot touched nothing; its nearest obstacle was {away_m:.2f} m away, at {at_s:.1f} s.{outside}"
    )


def _positions(run: RunData) -> VerdictLine | None:
    poses = run.table("poses")
    if run.simulated or poses is None:
        return None
    source, _ = Counter(poses["source"].tolist()).most_common(1)[0]
    if source == "fixed":
        return None
    text = f"From {_SOURCES.get(source, f'the topic {source}')}"
    bound_m = _bound_m(run)
    if bound_m is not None:
        coverage = run.metric("uwb_coverage_95")
        holds = "" if coverage is None else f" (95 % bound, holds on {short(100 * coverage, 3)} %)"
        text += f", ±{short(bound_m, 2)} m{holds or ' (95 % bound)'}"
    return VerdictLine("Positions", [Sentence(f"{text}{_against_truth(run)}"), *_unlocated(run)])


def _unlocated(run: RunData) -> Iterator[Sentence]:
    lost_s, recorded_s = run.record.counts.get("unlocated_ms", 0) * 1e-3, run.record.recorded_s
    if lost_s > 0 and recorded_s > 0:
        alarm = any(loss.cause == "positions" for loss in run.record.losses)
        yield Sentence(f"{short(100 * lost_s / recorded_s, 2)} % of the log has no measured position.", alarm)


def _against_truth(run: RunData) -> str:
    for name, what in (("ate_rmse_m", ""), ("uwb_rmse_m", "single fixes ")):
        if (error_m := run.metric(name)) is not None:
            return f", {what}{short(error_m, 2)} m off the reference (rms)."
    if run.reference_xy_m is not None:
        return ". The recording's reference cannot be compared with them."
    return ". The recording has no reference to check them against."


def _bound_m(run: RunData) -> float | None:
    """Half the longer axis of the poses' 95 % ellipse, median over the run; None where nothing is claimed."""
    of = run.table("pose_uncertainty")
    if of is None:
        return None
    xx, xy, yy = (of[name] for name in ("cov_xx_m2", "cov_xy_m2", "cov_yy_m2"))
    with np.errstate(invalid="ignore"):
        major_m2 = (xx + yy) / 2 + np.hypot((xx - yy) / 2, xy)
    known = major_m2[np.isfinite(major_m2)]
    return float(SCALE_95 * np.sqrt(max(np.median(known), 0.0))) if len(known) else None
