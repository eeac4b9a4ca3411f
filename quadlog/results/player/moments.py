"""Instants worth seeing: where each metric is at its worst, contacts, sample scans."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.planning import Replans, search_samples
from quadlog.metrics.summary import Samples, finite_samples, worst_of
from quadlog.metrics.walking import TrackedWalk, clearance_samples, tracking_samples
from quadlog.results.player.scene import Scene
from quadlog.results.plots.run_data import RunData
from quadlog.results.run.tables import METRIC_NAMES

MAX_CONTACTS = 8


@dataclass(frozen=True, slots=True)
class Moment:
    """An instant, its kind (contacts, worst, scans), what it shows, and the sample that makes it the worst one.

    also: further metrics of which it is the worst instant by the same sample.
    """

    seconds: float
    kind: str
    what: str
    also: tuple[str, ...] = ()
    value: float | None = None
    unit: str = ""


def moments_of(run: RunData, scene: Scene) -> list[Moment]:
    """Contacts first, then the worst instant of each saved metric, then sample scans.

    Metrics that are worst at the same instant by the same sample are one moment. Raises NotARun for damaged tables.
    """
    touches = [
        Moment(each.seconds, "contacts", f"{'collision' if each.collision else 'no collision'}: {each.cause}")
        for each in sorted(scene.contacts, key=lambda each: not each.collision)[:MAX_CONTACTS]
    ]
    clouds = [Moment(cloud.seconds, "scans", "obstacle points") for cloud in scene.clouds]
    return [each for each in (*touches, *_worst(run), *clouds) if scene.from_s <= each.seconds <= scene.until_s]


def _worst(run: RunData) -> list[Moment]:
    found: dict[tuple[float, float], list[str]] = {}
    values: dict[str, float] = {}
    samples = {name: each for read in _READERS for name, each in read(run).items() if name in run.metrics}
    for name in sorted(samples, key=METRIC_NAMES.index):
        if name in _COUNTED:
            continue
        for row in worst_of(name, samples[name], most=1):
            values[name] = float(samples[name].values[row])
            seconds = float(run.seconds(samples[name].t_ns[row : row + 1])[0])
            found.setdefault((seconds, abs(values[name])), []).append(name)
    return [
        Moment(seconds, "worst", names[0], tuple(names[1:]), values[names[0]], CATALOGUE[names[0]].unit)
        for (seconds, _), names in found.items()
    ]


_COUNTED = frozenset({"collisions", "fallen", "success_rate", "fallback_share", "expanded_total", "generated_total"})
"""Of sums of events each is as bad as the next; contacts have moments of their own."""


def _of_control(run: RunData) -> dict[str, Samples]:
    control = run.table("control")
    if control is None:
        return {}
    errors = ("error_m", "cross_track_m", "time_error_m", "heading_error_rad", "plan_error_m")
    return tracking_samples(TrackedWalk(control["t_ns"], **{name: control[name] for name in errors}))


def _of_clearances(run: RunData) -> dict[str, Samples]:
    table = run.table("clearances")
    return {} if table is None else clearance_samples(**table)


def _of_plans(run: RunData) -> dict[str, Samples]:
    plans = run.table("plans")
    # The course of a simulated walk was not searched for.
    if plans is None or run.simulated:
        return {}
    wanted = ("t_ns", "found", "expanded", "generated", "cost", "optimal_cost", "from_scratch")
    return search_samples(Replans(**{name: plans[name] for name in wanted}))


def _of_fixes(run: RunData) -> dict[str, Samples]:
    errors = run.table("uwb_errors")
    if errors is None:
        return {}
    rows = errors["source"] == "fixes"
    if len(set(errors["tag"][rows].tolist())) > 1:  # the metric is of the robot's first tag alone
        return {}
    error_m = np.hypot(errors["error_x_m"][rows], errors["error_y_m"][rows])
    return {"uwb_rmse_m": finite_samples(errors["t_ns"][rows], error_m, "rms")}


_READERS: Sequence[Callable[[RunData], dict[str, Samples]]] = (_of_control, _of_clearances, _of_plans, _of_fixes)
