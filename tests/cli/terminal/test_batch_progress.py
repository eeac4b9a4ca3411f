from __future__ import annotations

import io

import pytest
from rich.console import Console

from quadlog.cli.terminal.progress_bars import MAX_LINES, WorkerLines, duration_words, open_batch_progress, step_words
from quadlog.pipelines.batch.progress import BatchCounts, TaskProgress
from quadlog.pipelines.executor.progress import told_to


@pytest.fixture
def drawn(monkeypatch):
    """Lines on a terminal of our own, and what is on it at the end."""
    screen, lines = io.StringIO(), WorkerLines()
    lines._bars.live.console = Console(file=screen, force_terminal=True, width=140)
    return lines, screen


def step(number, worker="host:1", stage="map", steps=3, total=10, factor=2.5):
    return {
        "number": number,
        "run": f"walk\x1b[31m-{number}",
        "worker": worker,
        "stage": stage,
        "steps": steps,
        "total": total,
        "realtime_factor": factor,
        "peak_memory_mb": 1.0,
    }


def test_each_worker_has_a_line_and_all_have_one_with_the_time_left(drawn):
    lines, screen = drawn
    tally = BatchCounts(3, 300)
    with lines:
        lines.expect(tally, 2)
        lines.hear(step(0))
        lines.hear(step(1, worker="host:2", stage="filter", total=0, factor=None))
        tally.count(100, True, 60.0)
        lines.finish("walk\x1b[31m-0", "no lidar")
        lines.finish("gone", "done")
        lines._bars.refresh()
    text = screen.getvalue()
    assert "3/10  2.5x real time  host:1" in text
    assert "filter" in text
    assert "1/3 recordings, 1 failed, 60 s left" in text or "1/3 recordings, 1 failed, 1 min left" in text
    assert "walk\x1b[31m" not in text
    assert "no lidar" in text
    assert "gone" not in text


def test_more_workers_than_a_screen_holds_are_not_shown(drawn):
    lines, _ = drawn
    with lines:
        lines.expect(BatchCounts(1000, 1), 1000)
        for number in range(100):
            lines.hear(step(number, worker=f"host:{number}"))
        assert len(lines._bars.tasks) == MAX_LINES + 1


def test_words():
    assert step_words(step(0, total=0, steps=0, factor=None)) == "host:1"
    assert [duration_words(s) for s in (5, 90, 3599, 7200, 90061)] == [
        "5 s",
        "2 min",
        "60 min",
        "2 h 00 min",
        "25 h 01 min",
    ]


def test_a_pipe_gets_one_line_for_each_recording(capsys):
    tally = BatchCounts(2, 10)
    with open_batch_progress() as progress:
        progress.expect(tally, 2)
        progress.hear(step(0))
        tally.count(5, False, 1.0)
        progress.finish("walk", "done")
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "[1/2] walk: done\n")


def test_where_a_replay_is_is_told_with_its_rate_but_not_at_every_step(monkeypatch):
    now_s = [100.0]
    monkeypatch.setattr("quadlog.pipelines.batch.progress.time.monotonic", lambda: now_s[0])
    heard = []
    with told_to(heard.append, "tcp://worker"):
        told = TaskProgress(7, "walk")
        told.begin("map", 1000)
        for scan in range(100):
            now_s[0] += 0.1
            told.advance(0.3 * (scan + 1))
        told.say("warning: few ranges")
        told.say("robot position from uwb")
    assert told.warnings == ["warning: few ranges"]
    assert [each["stage"] for each in heard] == ["map"] * len(heard)
    assert 15 <= len(heard) <= 22
    assert heard[-1]["realtime_factor"] == pytest.approx(3.0)
    assert (heard[-1]["number"], heard[-1]["worker"], heard[-1]["total"]) == (7, "tcp://worker", 1000)
    assert heard[-1]["peak_memory_mb"] > 10
