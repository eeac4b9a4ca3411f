"""Two runs in one page: one player, charts laid over each other, paired differences, and where the runs part."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from quadlog.messages import Float
from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.comparison.paired import PairedDifference
from quadlog.results.compare.common_clock import LETTERS, CommonClock, not_comparable
from quadlog.results.compare.diff_text import first_line, value_text
from quadlog.results.compare.differences import FirstDifference, ResultDifference, RunDifference, ValueDifference
from quadlog.results.compare.run_diff import first_difference, first_of_results
from quadlog.results.page.html import format_number, render_page
from quadlog.results.page.metric_cards import MetricRow, interval_text, metric_themes
from quadlog.results.page.overlay import is_alike, overlaid_charts, robots_apart
from quadlog.results.page.player import player_of_two
from quadlog.results.page.report import moving_parts, run_title
from quadlog.results.page.verdict import Sentence, VerdictLine, verdict
from quadlog.results.player.moments import Moment
from quadlog.results.plots.figures import PLOTS
from quadlog.results.plots.run_data import RunData

_TOLD, _TOLD_COLUMNS = 4, 6
_PARTED_M = 0.1
"""Simulated robots farther apart walk differently, to the eye."""
_NS = 1e9
_COUNTS = (("collisions", "Contacts"), ("fallen", "Falls"))
Origins = Mapping[str, Sequence[ValueDifference]]


@dataclass(frozen=True, slots=True)
class RunPair:
    """Two runs on their common clock, their names, and what was compared of them.

    origins: how they were made differently, by kind. diff: None without a shared clock. differences: of metrics, by
    name. problems: sentences on what could not be read.
    """

    a: RunData
    b: RunData
    names: tuple[str, str]
    clock: CommonClock
    origins: Origins
    diff: RunDifference | None
    differences: Mapping[str, PairedDifference]
    problems: Sequence[str] = ()

    @property
    def runs(self) -> tuple[RunData, RunData]:
        """Both, A first."""
        return self.a, self.b


@dataclass(frozen=True, slots=True)
class ComparedMetric:
    """A metric of two runs; numbers are None and texts empty where there is none.

    difference: B less A, paired where pairs is not empty. better: A, B, undecided, ...; is_clear: beyond chance.
    """

    name: str
    label: str
    help: str
    unit: str
    a: float | None
    b: float | None
    difference: float | None
    interval: str
    pairs: str
    better: str
    is_clear: bool


@dataclass(frozen=True, slots=True)
class ComparedTheme:
    """The metrics of one theme that either run has."""

    title: str
    rows: list[ComparedMetric]


def side_by_side_page(pair: RunPair) -> bytes:
    """The page, in UTF-8. Raises NotARun for damaged files."""
    themes = _compared_themes(pair)
    stages = [] if pair.diff is None else list(_stages(pair.diff, pair.a))
    charts, player = overlaid_charts(pair.a, pair.b, pair.clock), player_of_two(pair.a, pair.b, list(_parting(pair)))
    return render_page(
        "side_by_side.html.jinja",
        **moving_parts(charts, player, bool(themes)),
        title=" and ".join(dict.fromkeys(map(run_title, pair.runs))),
        clock=pair.clock.words,
        verdict=[*_made(pair), *_parted(pair), *_measured(pair, themes)],
        not_comparable=[*not_comparable(pair.a, pair.b, pair.clock), *pair.problems],
        runs=[
            {
                "letter": letter,
                "name": name,
                "title": run_title(run),
                "simulated": run.simulated,
                "record": run.record,
                "verdict": verdict(run),
                "command": shlex.join(str(word) for word in run.record.command),
            }
            for letter, name, run in zip(LETTERS, pair.names, pair.runs, strict=True)
        ],
        settings=[
            {"kind": kind, "key": each.key, "a": value_text(each.a), "b": value_text(each.b)}
            for kind, found in pair.origins.items()
            for each in found
        ],
        lost_and_warned=_lost_and_warned(pair),
        stages=stages,
        themes=themes,
        # What differs comes first.
        figures=sorted((plot for plot in PLOTS if plot.name in charts), key=lambda plot: is_alike(charts[plot.name])),
    )


def _compared_themes(pair: RunPair) -> list[ComparedTheme]:
    """The groups of metrics, as the page of one run has them, with a row for each that either run has."""
    of_a, of_b = ({group.title: group.rows for group in metric_themes(run)} for run in pair.runs)
    groups = []
    for title in dict.fromkeys((*of_a, *of_b)):
        rows_a, rows_b = ({row.shown.name: row for row in of.get(title, [])} for of in (of_a, of_b))
        names = dict.fromkeys((*rows_a, *rows_b))
        groups.append(
            ComparedTheme(title, [_compared(pair, name, rows_a.get(name), rows_b.get(name)) for name in names])
        )
    return [group for group in groups if group.rows]


def _compared(pair: RunPair, name: str, a: MetricRow | None, b: MetricRow | None) -> ComparedMetric:
    row = a or b
    assert row is not None
    paired = pair.differences.get(name)
    difference = None if a is None or b is None else b.value - a.value if paired is None else paired.difference
    return ComparedMetric(
        name=name,
        label=row.shown.label,
        help=row.shown.help,
        unit=row.unit,
        a=None if a is None else a.value,
        b=None if b is None else b.value,
        difference=difference,
        interval="" if paired is None or paired.interval is None else interval_text(paired.interval),
        pairs="" if paired is None else _pairs(paired),
        better=_better(name, difference, paired),
        is_clear=paired is not None and paired.clear,
    )


def _pairs(paired: PairedDifference) -> str:
    alone = [
        f"{many} only in {run}" for run, many in zip(LETTERS, (paired.alone_a, paired.alone_b), strict=True) if many
    ]
    return ", ".join([format_number(paired.pairs), *alone])


def _better(name: str, difference: float | None, paired: PairedDifference | None) -> str:
    if difference is None:
        return ""
    if (paired is not None and paired.same) or (paired is None and difference == 0):
        return "the same"
    if paired is None or paired.interval is None:
        return ""
    if not paired.clear:
        return "undecided"
    better = CATALOGUE[name].better if name in CATALOGUE else ""
    if not better:
        return "differ"
    return "B" if (difference > 0) == (better == "higher") else "A"


def _made(pair: RunPair) -> Iterator[VerdictLine]:
    """How the runs were made differently."""
    found = [each for kind in ("config", "options", "seed") for each in pair.origins.get(kind, ())]
    if found:
        named = [f"{each.key} ({value_text(each.a)} in A, {value_text(each.b)} in B)" for each in found[:_TOLD]]
        more = f" and {len(found) - _TOLD} more" if len(found) > _TOLD else ""
        text = f"{len(found)} setting{'s differ' if len(found) > 1 else ' differs'}: {', '.join(named)}{more}."
    else:
        text = "Config, options and seed are the same."
    sentences = [Sentence(text)]
    if pair.origins.get("input"):
        sentences.append(Sentence("The inputs differ."))
    if pair.origins.get("versions"):
        sentences.append(Sentence("The versions differ."))
    yield VerdictLine("Settings", sentences)


def _parted(pair: RunPair) -> Iterator[VerdictLine]:
    """Until where the results are the same."""
    if pair.diff is None:
        return
    first = first_difference(pair.diff)
    if first is None:
        yield VerdictLine("Results", [Sentence("All saved results are the same.")])
        return
    before = list(pair.diff.stages)[: list(pair.diff.stages).index(first.stage)]
    same = [stage for stage in before if pair.diff.stages[stage]]
    start = f"The same through {', '.join(same)}. " if same else ""
    sentences = [Sentence(f"{start}They part first in {first_line(first, pair.a.start_ns, False)}.")]
    apart = robots_apart(pair.a, pair.b)
    if apart is not None:
        sentences.append(Sentence(_apart_words(*apart)))
    yield VerdictLine("Results", sentences)


def _apart_words(seconds: Float, apart_m: Float) -> str:
    parted, most = _parted_rows(apart_m)
    words = f"The simulated robots were at most {apart_m[most]:.2f} m apart, at {seconds[most]:.1f} s"
    return f"{words}." if parted is None else f"{words}; first more than {_PARTED_M:g} m at {seconds[parted]:.1f} s."


def _parted_rows(apart_m: Float) -> tuple[int | None, int]:
    """The rows where the simulated robots, apart_m (N,) apart, were first parted, if they were, and most apart."""
    parted = np.flatnonzero(apart_m > _PARTED_M)
    return int(parted[0]) if len(parted) else None, int(np.argmax(apart_m))


def _measured(pair: RunPair, themes: Sequence[ComparedTheme]) -> Iterator[VerdictLine]:
    """Which run is better in what, and their contacts and falls."""
    rows = [row for theme in themes for row in theme.rows]
    sentences = []
    for letter in ("B", "A"):
        found = [row for row in rows if row.is_clear and row.better == letter]
        named = ", ".join(f"{row.label} (by {_size(row)})" for row in found[:_TOLD])
        more = f" and {len(found) - _TOLD} more" if len(found) > _TOLD else ""
        if found:
            sentences.append(Sentence(f"{letter} is better beyond chance in {named}{more}."))
    undecided = sum(row.better == "undecided" for row in rows)
    if undecided:
        what = "difference" if undecided == 1 else "differences"
        sentences.append(Sentence(f"{undecided} {what} with an interval may be chance."))
    for name, what in _COUNTS:
        values = [run.metric(name) for run in pair.runs]
        if None not in values:
            a, b = (format_number(float(value or 0)) for value in values)
            sentences.append(Sentence(f"{what}: {a} in A, {b} in B.", alarm=any(values)))
    if sentences:
        yield VerdictLine("Metrics", sentences)


def _size(row: ComparedMetric) -> str:
    return f"{format_number(abs(row.difference or 0.0))} {row.unit}".strip()


def _lost_and_warned(pair: RunPair) -> list[dict[str, Any]]:
    """Losses and warnings that both runs have, then those of each alone; `run` names the runs."""
    losses, warnings = ([list(getattr(run.record, name)) for run in pair.runs] for name in ("losses", "warnings"))
    both = {"losses": _shared(*losses), "warnings": _shared(*warnings)}
    boxes = [{"run": "A and B", **both}]
    for letter, lost, warned in zip(LETTERS, losses, warnings, strict=True):
        own = {"losses": [each for each in lost if each not in both["losses"]]}
        boxes.append({"run": letter, **own, "warnings": [each for each in warned if each not in both["warnings"]]})
    return boxes


def _shared(a: Sequence[Any], b: Sequence[Any]) -> list[Any]:
    return [each for each in a if each in b]


def _stages(diff: RunDifference, run: RunData) -> Iterator[dict[str, Any]]:
    """A row for each result that differs, the first of its stage first, and for each stage without one."""
    for stage, results in diff.stages.items():
        firsts = [(first, each) for each in results if (first := first_of_results(stage, [each])) is not None]
        if not firsts:
            state = "the same" if results else "nothing saved"
            yield {"stage": stage, "state": state, "seconds": None, "what": "", "more": ""}
        for first, result in sorted(firsts, key=lambda each: _seconds(each[0], run) or 0.0):
            text = first_line(first, run.start_ns, False).removeprefix(f"stage {stage}: ")
            yield {
                "stage": stage,
                "state": "differs",
                "seconds": _seconds(first, run),
                "what": text,
                "more": _also(first, result),
            }


def _also(first: FirstDifference, result: ResultDifference) -> str:
    """The other columns or values of the result that differ, the first few by name."""
    names = [*(each.column for each in result.columns), *(each.key for each in result.values)]
    others = [name for name in names if name != first.column]
    more = f" and {len(others) - _TOLD_COLUMNS} more" if len(others) > _TOLD_COLUMNS else ""
    return f"{', '.join(others[:_TOLD_COLUMNS])}{more}"


def _seconds(first: FirstDifference, run: RunData) -> float | None:
    return None if first.place is None or first.place.t_ns is None else (first.place.t_ns - run.start_ns) / _NS


def _parting(pair: RunPair) -> Iterator[Moment]:
    """The instant of the first difference of each result that has one, and those of the simulated robots."""
    if pair.diff is None:
        return
    for stage, results in pair.diff.stages.items():
        for first in (first_of_results(stage, [each]) for each in results):
            seconds = None if first is None else _seconds(first, pair.a)
            if first is not None and seconds is not None:
                yield Moment(seconds, "parting", first.result)
    apart = robots_apart(pair.a, pair.b)
    if apart is not None and apart[1].any():
        parted, most = _parted_rows(apart[1])
        if parted is not None:
            yield Moment(float(apart[0][parted]), "parting", f"robots {_PARTED_M:g} m apart")
        yield Moment(float(apart[0][most]), "parting", "robots most apart", value=float(apart[1][most]), unit="m")
