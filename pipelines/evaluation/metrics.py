"""`quadlog metrics` and `quadlog check`: the metrics of saved runs from their files alone, and bounds on them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from quadlog.config.file import read_bounds
from quadlog.errors import ExitCode, NotARun, QuadlogError, printable
from quadlog.messages import NS_PER_S
from quadlog.metrics.catalogue import CATALOGUE, Condition
from quadlog.metrics.summary import MeasuredRun, Metric, Metrics, Samples, detail_of, metrics_of, worst_of
from quadlog.pipelines.evaluation import reference as references
from quadlog.pipelines.evaluation.samples import SAMPLED, read_samples
from quadlog.results import check
from quadlog.results.diff import differing_settings
from quadlog.results.find_runs import failed_recordings, find_runs, refuse_existing, run_labels
from quadlog.results.record import read_metrics
from quadlog.results.run import Run
from quadlog.results.tables import start_ns
from quadlog.results.text import explain_text, print_table
from quadlog.storage.atomic_write import new_folder, write_whole


def explain_runs(name: str, runs: Sequence[MeasuredRun], reference: references.Reference | None) -> str:
    """The metric explained, with the three worst instants of each run."""
    return explain_text(name, {run.label: _at_worst(name, run, reference) for run in runs})


def _at_worst(name: str, run: MeasuredRun, reference: references.Reference | None) -> list[str]:
    measured, unit = run.metrics.get(name), CATALOGUE[name].unit
    if measured is None:
        return ["has no such metric"]
    known = f"{f'{measured.value:.6g} {unit}'.rstrip()}, n = {measured.n}"
    try:
        samples, first_ns = _samples(name, run.path, reference), start_ns(run.path)
    except QuadlogError as error:
        return [f"{known}; worst instants unknown: {error}"]
    if samples is None:
        return [f"{known}; a run saves no samples of it"]
    worst = [(int(samples.t_ns[at]), float(samples.values[at])) for at in worst_of(name, samples)]
    if not worst:
        return [f"{known}; never above zero"]
    rows = [(t_ns, f"{(t_ns - first_ns) / NS_PER_S:.3f}", f"{value:.6g}") for t_ns, value in worst]
    table = print_table(("t_ns", "s from start", f"sample {unit}".rstrip()), rows).splitlines()
    return [f"{known}; worst, at least 1 s apart:", *table]


def _samples(name: str, run: Path, reference: references.Reference | None) -> Samples | None:
    if name not in SAMPLED:
        return None
    if reference is not None and name in references.REFERENCE_METRICS:
        return references.compare_with_reference(run, reference).samples.get(name)
    samples, errors = read_samples(run, [name])
    if errors:
        raise errors[0]
    return samples.get(name)


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
    paths: Sequence[Path],
    reference: references.Reference | None,
    conditions: Sequence[Condition],
    in_detail: bool = False,
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
            said += lines
        except QuadlogError as error:
            if len(found) == 1:
                raise
            problems.append(str(error))
            failing += [f"{path}: {each}: unknown, the run cannot be read" for each in conditions]
            continue
        runs.append(MeasuredRun(path, label, measured, run.record.recorded_s))
        records.append(run.record)
        problems += damage
        failing += _failing(path, measured, conditions)
    for path, why in failed_recordings(paths).items():
        problems.append(why)
        failing += [f"{path}: {each}: unknown, it was not replayed" for each in conditions]
    if not runs:
        raise NotARun(paths[0], f"not one of {len(found)} runs can be read: {problems[0]}")
    return MetricsOutcome(runs, differing_settings(records), said, problems, failing)


def _measure(run: Run, reference: references.Reference | None, detail: bool) -> tuple[Metrics, list[str], list[str]]:
    """The metrics of one run in the contract's order, lines for people, and what is damaged."""
    if not (run.path / "metrics.json").is_file():
        raise NotARun(run.path, "has no metrics.json")
    metrics = {
        name: Metric(
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
        metrics |= {
            name: replace(metrics[name], detail=detail_of(each)) for name, each in samples.items() if len(each.values)
        }
    if reference is not None:
        metrics = {name: each for name, each in metrics.items() if name not in references.REFERENCE_METRICS}
        compared = references.compare_with_reference(run.path, reference)
        said += compared.said
        measured = metrics_of(compared.samples)
        metrics |= {name: replace(of, detail=detail_of(compared.samples[name])) for name, of in measured.items()}
    return {name: metrics[name] for name in CATALOGUE if name in metrics}, said, problems


def _failing(run: Path, metrics: Mapping[str, Metric], conditions: Sequence[Condition]) -> list[str]:
    lines = []
    for each in conditions:
        measured = metrics.get(each.name)
        if measured is None:
            lines.append(f"{run}: {each}: unknown, the run has no {each.name}")
        elif each.holds(measured.value):
            lines.append(f"{run}: {each} holds: {measured.value:.9g} {measured.unit}".rstrip())
    return lines


def check_runs(
    paths: Sequence[Path], expect: Path, junit: Path | None, force: bool, say: Callable[[str], None]
) -> list[check.RunCheck]:
    """Check every run; junit: where to write the JUnit XML, None for nowhere.

    A run that cannot be read has an error, and so has a recording that could not be replayed. Raises NotARun for a path
    without runs, AlreadyExists, CannotWrite, UsageError, and what reading the file of bounds raises.
    """
    if junit is not None:
        refuse_existing(junit, force, [expect, *paths])
    bounds, checks, given = read_bounds(expect), list[check.RunCheck](), set[str]()
    for path in find_runs(paths):
        try:
            run = Run(path)
            read_metrics(path)  # where they are missing or damaged, the check fails, whatever the bounds
            checks.append(check.check_run(run, bounds))
            given |= set(check.bound_names(run))
        except QuadlogError as error:
            checks.append(check.RunCheck(str(path), path.resolve().name, error=str(error)))
    checks += [check.RunCheck(str(run), run.name, error=why) for run, why in failed_recordings(paths).items()]
    # Recordings with bounds but without a run would otherwise pass unnoticed.
    if unchecked := sorted(bounds.keys() - given - {""}):
        say(f"not checked, no such run was given: {', '.join(unchecked)}")
    if junit is not None:
        with new_folder(junit.parent):
            write_whole(junit, check.junit_xml(checks, run_labels(Path(each.run) for each in checks)))
    return checks


def propose_bounds(paths: Sequence[Path], expect: Path, force: bool, say: Callable[[str], None]) -> dict[str, int]:
    """Write bounds made from the runs into a new file; returns how many for each name.

    Bounds that accept a contact or a fall are listed; metrics that the catalogue lacks are listed, not bounded.
    Raises NotARun, AlreadyExists for an existing file unless `force`, CannotWrite.
    """
    refuse_existing(expect, force, paths)
    runs = [Run(path) for path in find_runs(paths)]
    bounds = check.propose(runs)
    with new_folder(expect.parent):
        write_whole(expect, check.bounds_toml(bounds))
    for name, mine in bounds.items():
        if events := [metric for metric in check.EVENTS if metric in mine and mine[metric].max]:
            say(f"warning: the bounds for {name} accept {', '.join(events)}")
    if unknown := sorted({name for run in runs for name in run.metrics} - CATALOGUE.keys()):
        say(f"not bounded, no metrics of quadlog's catalogue: {', '.join(unknown)}")
    return {name: len(mine) for name, mine in bounds.items()}
