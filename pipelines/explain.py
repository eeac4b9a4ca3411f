"""`quadlog metrics --explain`: when runs were at their worst by one metric."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from quadlog.errors import QuadlogError
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.measured import MeasuredRun
from quadlog.metrics.summary import Samples
from quadlog.metrics.worst import worst_instants
from quadlog.pipelines.reference import REFERENCE_METRICS, Reference, compare_with_reference
from quadlog.pipelines.saved_samples import SAMPLED, read_samples
from quadlog.results.explain_text import Instant, RunAtWorst, explain_text
from quadlog.results.run_start import start_ns

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
    except QuadlogError as error:
        return RunAtWorst(run.label, measured.value, measured.n, (), f"worst instants cannot be told: {error}")
    why = "a run saves no samples of it" if samples is None else "at no instant bad"
    return RunAtWorst(run.label, measured.value, measured.n, instants, why)


def _samples(name: str, run: Path, reference: Reference | None) -> Samples | None:
    if name not in SAMPLED:
        return None
    if reference is not None and name in REFERENCE_METRICS:
        return compare_with_reference(run, reference).samples.get(name)
    samples, problems = read_samples(run, [name])
    if problems:
        raise QuadlogError(problems[0])
    return samples.get(name)


def _instants(name: str, samples: Samples, first_ns: int) -> list[Instant]:
    values = samples.values
    badness = values.max(initial=1.0) - values if CATALOGUE[name].worst_is_lowest else np.abs(values)
    return [
        Instant(int(samples.t_ns[i]), (int(samples.t_ns[i]) - first_ns) / _NS, float(values[i]))
        for i in worst_instants(samples.t_ns, badness)
    ]
