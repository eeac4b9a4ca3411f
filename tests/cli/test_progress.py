from __future__ import annotations

import io
import sys

from quadlog.cli.progress import open_progress
from quadlog.pipelines.executor.progress import BatchCounts


def terminal(monkeypatch):
    """What is drawn on a terminal in place of stderr."""
    screen = io.StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    return screen


def test_bars_show_stages_rates_the_time_left_and_no_escape_sequence(monkeypatch):
    """Every stage ends full; a topic's escape sequence is not obeyed; NO_COLOR is."""
    screen = terminal(monkeypatch)
    monkeypatch.setenv("NO_COLOR", "1")
    with open_progress() as progress:
        progress.begin("ingest", None)
        progress.begin("filter", 4)
        for step in range(3):
            progress.advance(0.1 * step)
            progress._bars.refresh()
        progress.advance(0.4)
        progress.say("topic \x1b[31m/points")
    drawn = screen.getvalue()
    assert all(words in drawn for words in ("3/4", "4/4", "real time", "0:00:0", "topic "))
    assert "\x1b[31m" not in drawn


def test_a_pipe_gets_lines_only(capsys):
    tally = BatchCounts(2)
    with open_progress() as progress:
        progress.begin("filter", 3)
        progress.advance(1.0)
        progress.say("robot position from uwb")
        progress.expect(tally)
        progress.hear(step(0))
        tally.done += 1
        progress.finish("walk", "done")
    assert capsys.readouterr() == ("", "robot position from uwb\n[1/2] walk: done\n")


def step(number, total=10, factor=2.5):
    who = {"number": number, "run": f"walk\x1b[31m-{number}", "worker": "host:1", "peak_memory_mb": 1.0}
    return who | {"stage": "map", "steps": 3, "total": total, "realtime_factor": factor}


def test_a_batch_has_one_bar_with_what_was_done_last(monkeypatch):
    screen = terminal(monkeypatch)
    tally = BatchCounts(3)
    with open_progress() as bars:
        bars.expect(tally)
        for heard in (step(0), step(1, total=0, factor=None)):
            bars.hear(heard)
            bars._bars.refresh()
        tally.done, tally.failed = 1, 1
        bars.finish("walk\x1b[31m-0", "no lidar")
        bars._bars.refresh()
    text = screen.getvalue()
    assert all(words in text for words in ("map 3/10 2.5x real time", "map 3/?", "no lidar", "1/3", "1 failed"))
    assert "walk\x1b[31m" not in text
