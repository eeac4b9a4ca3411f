"""`quadlog metrics`: the metrics of saved runs, from their files alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from quadlog.errors import ExitCode, NotARun, QuadlogError, printable
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.conditions import Condition
from quadlog.metrics.reference_offset import TRAJECTORY_METRICS
from quadlog.metrics.summary import (
    Measured,
    MeasuredRun,
    Samples,
    summarise,
    worst_of,
)
from quadlog.pipelines.evaluation.reference import (
    REFERENCE_METRICS,
    Reference,
    compare_with_own_reference,
    compare_with_reference,
)
from quadlog.pipelines.evaluation.samples import SAMPLED, read_samples
from quadlog.results.diff import differing_settings
from quadlog.results.find_runs import failed_recordings, find_runs, run_labels
from quadlog.results.run import Run
from quadlog.results.tables import has_table, read_table, start_ns
from quadlog.results.text import RunAtWorst, WorstInstant, explain_text, print_table

_NS = 1_000_000_000


def explain_runs(name: str, runs: Sequence[MeasuredRun], reference: Reference | None) -> str:
    """The metric explained, with the three worst instants of each run."""
    return explain_text(name, [_at_worst(name, run, reference) for run in runs])


def _at_worst(name: str, run: MeasuredRun, reference: Reference | None) -> RunAtWorst:
    measured = run.metrics.get(name)
    if measured is None:
        return RunAtWorst(run.label, None, 0, ())
    try:
        samples = _samples(name, run.path, reference)
        instants = [] if samples is None else _instants(name, samples, start_ns(run.path))
        details = _contacts(run.path) if name in _OF_CONTACTS else _dimensions(name, run.path, reference)
    except QuadlogError as error:
        return RunAtWorst(run.label, measured.value, measured.n, (), f"worst instants unknown: {error}")
    why = "a run saves no samples of it" if samples is None else "never above zero"
    return RunAtWorst(run.label, measured.value, measured.n, instants, why, details)


_OF_CONTACTS = ("collisions", "clearance_min_m")


def _contacts(run: Path) -> list[str]:
    """A table of the run's contacts, from their first line on; nothing where there is none."""
    if not has_table(run, "contacts"):
        return []
    contacts = read_table(run, "contacts")
    if len(contacts["t_ns"]) == 0:
        return []
    first_ns = start_ns(run)
    rows = [
        (f"{(t_ns - first_ns) / _NS:.3f}", f"{duration_s:.3f}", f"{x_m:.2f}", f"{y_m:.2f}", f"{clearance_m:.3f}",
         "yes" if collision else "no", cause)
        for t_ns, duration_s, x_m, y_m, clearance_m, cause, collision in zip(*contacts.values(), strict=True)
    ]  # fmt: skip
    head = ("from s", "for s", "x m", "y m", "clearance m", "collision", "cause")
    return ["contacts, s from start:", *print_table(head, rows).splitlines()]


def _dimensions(name: str, run: Path, reference: Reference | None) -> list[str]:
    """Whether a metric of a trajectory is of errors in the plane or in space; nothing for other metrics."""
    if name not in TRAJECTORY_METRICS:
        return []
    compared = compare_with_own_reference(run) if reference is None else compare_with_reference(run, reference)
    return [] if compared is None else [f"errors in {compared.dimensions}"]


def _samples(name: str, run: Path, reference: Reference | None) -> Samples | None:
    if name not in SAMPLED:
        return None
    if reference is not None and name in REFERENCE_METRICS:
        return compare_with_reference(run, reference).samples.get(name)
    samples, errors = read_samples(run, [name])
    if errors:
        raise errors[0]
    return samples.get(name)


def _instants(name: str, samples: Samples, first_ns: int) -> list[WorstInstant]:
    values = samples.values
    return [
        WorstInstant(int(samples.t_ns[i]), (int(samples.t_ns[i]) - first_ns) / _NS, float(values[i]))
        for i in worst_of(name, samples)
    ]


@dataclass(frozen=True, slots=True)
class MetricsOutcome:
    """The runs that could be read, in their order.

    differing: how the runs' settings differ, a line each; such runs are not averaged. said: lines on how they were
    read; problems: a line for everything that could not be; failing: a line for every condition that holds on a run,
    or is unknown.
    """

    runs: list[MeasuredRun]
    differing: list[str]
    said: list[str]
    problems: list[str]
    failing: list[str]

    @property
    def exit_code(self) -> ExitCode:
        """CHECK_FAILED before WITH_LOSS before DONE."""
        if self.failing:
            return ExitCode.CHECK_FAILED
        return ExitCode.WITH_LOSS if self.problems else ExitCode.DONE


def measure_runs(
    paths: Sequence[Path], reference: Reference | None, conditions: Sequence[Condition], in_detail: bool = False
) -> MetricsOutcome:
    """Every metric of every run among the paths (see `find_runs`), in their order, from metrics.json.

    in_detail: whether the samples behind the values are read too.
    A condition on a metric that a run does not have, on a run that cannot be read, or on a recording of the folder that
    could not be replayed, counts as failing: a check that could not be made has not been passed.

    Raises NotARun for a path without a run, and what is wrong with the runs when not one of them can be read.
    """
    found = find_runs(paths)
    runs: list[MeasuredRun] = []
    records, said, problems, failing = [], [], [], []
    for path, label in zip(found, run_labels(found), strict=True):
        try:
            run = Run(path)
            measured, lines, damage = _measure(run, reference, in_detail)
            if reference is None and len(found) == 1 and not measured.keys().isdisjoint(TRAJECTORY_METRICS):
                lines, damage = _say_dimensions(path, damage)
            said += lines
        except QuadlogError as error:
            if len(found) == 1:
                raise
            problems.append(str(error))
            failing += [f"{path}: {each}: unknown, the run cannot be read" for each in conditions]
            continue
        runs.append(MeasuredRun(path, label, measured))
        records.append(run.record)
        problems += damage
        failing += _failing(path, measured, conditions)
    for path, why in failed_recordings(paths).items():
        problems.append(why)
        failing += [f"{path}: {each}: unknown, it was not replayed" for each in conditions]
    if not runs:
        raise NotARun(paths[0], f"not one of {len(found)} runs can be read: {problems[0]}")
    return MetricsOutcome(runs, differing_settings(records), said, problems, failing)


def _measure(run: Run, reference: Reference | None, detail: bool) -> tuple[dict[str, Measured], list[str], list[str]]:
    """The metrics of one run in the contract's order, lines for people, and what is damaged."""
    if not (run.path / "metrics.json").is_file():
        raise NotARun(run.path, "has no metrics.json")
    metrics = {
        name: Measured(
            *(float(of.value), of.n, printable(of.unit)),
            None if of.low is None or of.high is None else (of.low, of.high),
        )
        for name, of in run.metrics.items()
        if name in CATALOGUE
    }
    said: list[str] = []
    problems: list[str] = []
    if detail:
        samples, errors = read_samples(run.path, metrics)
        problems += dict.fromkeys(map(str, errors))
        metrics |= {name: replace(metrics[name], summary=summarise(each)) for name, each in samples.items()}
    if reference is not None:
        metrics = {name: each for name, each in metrics.items() if name not in REFERENCE_METRICS}
        compared = compare_with_reference(run.path, reference)
        said += compared.said
        metrics |= _measured(compared.samples)
    return {name: metrics[name] for name in CATALOGUE if name in metrics}, said, problems


def _say_dimensions(run: Path, damage: list[str]) -> tuple[list[str], list[str]]:
    """A line on whether errors of the trajectory are in the plane or in space, or what is damaged with it."""
    try:
        return [f"{run}: {words}" for words in _dimensions(TRAJECTORY_METRICS[0], run, None)], damage
    except QuadlogError as error:
        return [], list(dict.fromkeys([*damage, str(error)]))


def _measured(samples: Mapping[str, Samples]) -> dict[str, Measured]:
    found = {name: summarise(each) for name, each in samples.items()}
    return {
        name: Measured(of.value, of.n, CATALOGUE[name].unit, of.interval, of)
        for name, of in found.items()
        if of is not None and of.value == of.value
    }


def _failing(run: Path, metrics: Mapping[str, Measured], conditions: Sequence[Condition]) -> list[str]:
    lines = []
    for each in conditions:
        measured = metrics.get(each.name)
        if measured is None:
            lines.append(f"{run}: {each}: unknown, the run has no {each.name}")
        elif each.holds(measured.value):
            lines.append(f"{run}: {each} holds: {measured.value:.9g} {measured.unit}".rstrip())
    return lines
