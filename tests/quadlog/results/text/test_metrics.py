from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import pandas as pd
import pytest

from quadlog.metrics.catalogue import CATALOGUE
from quadlog.metrics.summary import Measured, MeasuredRun, SampleSummary, spread
from quadlog.results.run.tables import METRIC_NAMES
from quadlog.results.text.metrics import FORMATS, RunAtWorst, WorstInstant, explain_text, format_metrics
from quadlog.results.text.walks import walks_text

SUMMARY = SampleSummary(0.25, 600, 0.25, 0.125, 0.2, 0.5, (0.2, 0.3))
NASTY = "a|b_$x#\x1b[31m\nc & 100% ~^{}<script>"


def a_run(label: str, eta_m: float, **more: float) -> MeasuredRun:
    metrics = {"eta_m": Measured(eta_m, 600, "m", SUMMARY), "expanded_total": Measured(593.0, 120, "")}
    metrics |= {name: Measured(value, 1, "") for name, value in more.items()}
    return MeasuredRun(Path("runs") / label, label, metrics)


def text_of(runs: list[MeasuredRun], to: str) -> str:
    names = [name for name in METRIC_NAMES if any(name in run.metrics for run in runs)]
    over = {name: spread([run.metrics[name].value for run in runs if name in run.metrics]) for name in names}
    return format_metrics(runs, {name: each for name, each in over.items() if each}, to)


def test_json_is_flat_and_leaves_out_what_does_not_apply() -> None:
    found = json.loads(text_of([a_run("a", 0.25), a_run("b", 0.1, fallen=1.0)], "json"))
    assert found == [
        {"run": "runs/a", "eta_m": 0.25, "expanded_total": 593.0},
        {"run": "runs/b", "eta_m": 0.1, "expanded_total": 593.0, "fallen": 1.0},
    ]


def test_csv_has_a_row_per_run_and_metric() -> None:
    table = pd.read_csv(io.StringIO(text_of([a_run("a", 0.25), a_run("b", 0.1 + 0.2)], "csv")))
    assert list(table.columns) == ["run", "metric", "value", "unit", "n", "mean", "std", "p50", "p95", "low", "high"]
    assert table["value"].tolist() == [0.25, 593.0, 0.1 + 0.2, 593.0]
    assert table.loc[0, ["n", "std", "p50", "p95", "low", "high"]].tolist() == [600, 0.125, 0.2, 0.5, 0.2, 0.3]
    assert table.loc[1, ["mean", "low"]].isna().all()


def test_one_run_is_shown_with_its_samples() -> None:
    lines = text_of([a_run("walk", 0.25)], "table").splitlines()
    assert lines[0] == "Metrics of walk; low, high: 95 % interval"
    assert lines[2].split() == ["metric", "unit", "value", "n", "mean", "std", "p50", "p95", "low", "high"]
    assert " ".join(lines[3].split()) == "eta_m m 0.2500 600 0.2500 0.1250 0.2000 0.5000 0.2000 0.3000"
    assert lines[4].split() == ["expanded_total", "593", "120"]


def test_a_few_runs_stand_side_by_side() -> None:
    lines = text_of([a_run("a", 1.0), a_run("b", 2.0, fallen=0.0), a_run("c", 3.0)], "table").splitlines()
    assert lines[2].split() == ["metric", "unit", "a", "b", "c", "mean", "std", "low", "high"]
    assert lines[3].split()[:7] == ["eta_m", "m", "1", "2", "3", "2", "1"]
    fallen = next(line for line in lines if line.startswith("fallen"))
    assert fallen.split() == ["fallen", "0", "0"]
    assert fallen.index("0") == lines[3].index("2"), "under its own run"


def test_many_runs_are_summed_up_with_the_extremes_named() -> None:
    lines = text_of([a_run(f"r{i}", float(i)) for i in range(10)], "table").splitlines()
    assert lines[2].split()[:7] == ["metric", "unit", "runs", "mean", "std", "p50", "p95"]
    row = lines[3].split()
    assert row[:4] == ["eta_m", "m", "10", "4.500"]
    assert row[-4:] == ["0", "r0", "9", "r9"]


def test_runs_of_different_settings_are_listed_six_to_a_table() -> None:
    runs = [a_run(f"r{i}", float(i)) for i in range(8)]
    text = format_metrics(runs, {}, "table", ["planner.name: astar, ia_star"])
    headers = [line.split() for line in text.splitlines() if line.startswith("metric ")]
    assert headers == [["metric", "unit", *(f"r{i}" for i in range(6))], ["metric", "unit", "r6", "r7"]]
    assert text.endswith("because their settings differ:\n  planner.name: astar, ia_star\n")
    assert "mean" not in text


def test_names_too_long_for_a_line_are_numbered() -> None:
    runs = [a_run(f"2024-05-0{day}-a-recording-of-a-long-walk", 0.1 * day) for day in range(1, 5)]
    lines = text_of(runs, "table").splitlines()
    assert lines[1] == "run 1: 2024-05-01-a-recording-of-a-long-walk"
    assert max(map(len, lines)) <= 120
    header = next(line for line in lines if line.startswith("metric"))
    assert re.findall(r"run \d", header) == ["run 1", "run 2", "run 3", "run 4"]


@pytest.mark.parametrize("count", [1, 2, 7])
@pytest.mark.parametrize("to", FORMATS)
def test_a_run_of_any_name_is_shown_as_it_is(to: str, count: int) -> None:
    text = text_of([a_run(f"{NASTY}{i}", 0.1) for i in range(count)], to)
    assert to == "csv" or "\x1b" not in text  # a program gets the very path
    if to == "latex":
        assert re.search(r"(?<!\\)[&%$#_](?![^\n]*\\\\)", text.split("\\caption{")[1].split("}\n")[0]) is None
        assert r"a\textbar{}b\_\$x\#" in text
        rows = [line for line in text.splitlines() if line.endswith(r"\\")]
        assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {
            len(re.findall(r"[lr]", text.split(r"\begin{tabular}{@{}")[1].split("@{}}")[0])) - 1
        }
    if to == "markdown":
        rows = [line for line in text.splitlines() if line.startswith("|")]
        assert len({len(re.findall(r"(?<!\\)\|", row)) for row in rows}) == 1
        assert "<script>" not in text
    if to == "csv":
        assert len(list(csv.reader(io.StringIO(text)))) == 1 + 2 * count


def test_latex_has_booktabs_caption_and_label() -> None:
    text = text_of([a_run("a", 0.25), a_run("b", -0.5)], "latex")
    for part in (r"\caption{Metrics of 2 runs; low, high: 95 \% interval}", r"\label{tab:metrics}", r"\toprule"):
        assert part in text
    assert r"eta\_m & m & 0.2500 & $-0.5000$ & $-0.1250$" in text


def test_latex_numbers_names_that_are_too_long_and_tells_them_below() -> None:
    names = [f"2024-05-0{day}-a-recording-of-a-long-walk" for day in range(1, 9)]
    text = text_of([a_run(name, 0.1 * day) for day, name in enumerate(names[:4])], "latex")
    assert "metric & unit & run 1 & run 2 & run 3 & run 4 & mean & std & low & high" in text
    assert [text.replace(r"\allowbreak{}", "").count(name) for name in names] == [1] * 4 + [0] * 4
    runs = [a_run(name, 0.1 * day, following_distance_mean_m=2.001 + day) for day, name in enumerate(names)]
    first, second = text_of(runs, "latex").split(r"\midrule")[1:]
    assert "run 1" not in first
    assert r"eta\_m & m & 0 & run 1 & 0.7000 & run 2 \\" in second
    legend = "run 1: 2024-05-01-a-recording-of-a-long-walk; run 2: 2024-05-08-a-recording-of-a-long-walk"
    assert legend in second.replace(r"\allowbreak{}", "")


def test_latex_divides_what_is_too_wide() -> None:
    names = ("following_distance_mean_m", "rpe_rmse_m")
    runs = [a_run(f"walk-{i}", 1e-7 * i, **dict.fromkeys(names, 0.00012345 * i)) for i in range(1, 7)]
    text = text_of(runs, "latex")
    assert re.findall(r"\\label\{(.*)\}", text) == ["tab:metrics", "tab:metrics-2"]
    first, second = re.findall(r"\nmetric & unit & (.*) ", text)
    assert first == " & ".join(f"walk-{i}" for i in range(1, 7))
    assert second == "mean & std & low & high"
    assert text.count(r"eta\_m &") == 2


def test_a_path_that_is_no_text_can_be_written() -> None:
    run = MeasuredRun(Path("runs/\udcff"), "\udcff", {"eta_m": Measured(1.0, 1, "m")})
    for to in FORMATS:
        assert b"eta" in text_of([run], to).encode()


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_metric_can_be_explained(name: str) -> None:
    text = explain_text(name, [])
    entry = CATALOGUE[name]
    for what in (name, entry.meaning, entry.formula, entry.source, entry.counted):
        assert what in text
    assert max(map(len, text.splitlines())) <= 120


def test_runs_with_without_and_without_samples() -> None:
    instants = [
        WorstInstant(1_700_000_000_500_000_000, 0.5, 0.052),
        WorstInstant(1_700_000_002_000_000_000, 2.0, -0.01),
    ]
    runs = [
        RunAtWorst("a\x1b", 0.0075, 596, instants),
        RunAtWorst("b", None, 0, ()),
        RunAtWorst("c", 1.0, 3, (), "at no instant bad"),
    ]
    text = explain_text("cross_track_rmse_m", runs)
    assert "a\N{REPLACEMENT CHARACTER}: 0.0075 m, n = 596; worst, at least 1 s apart:" in text
    assert "  1700000000500000000         0.500     0.052\n  1700000002000000000         2.000     -0.01\n" in text
    assert "b: has no such metric" in text
    assert "c: 1 m, n = 3; at no instant bad" in text


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
