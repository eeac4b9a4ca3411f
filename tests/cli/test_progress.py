from __future__ import annotations

import io
import sys
import threading

from quadlog.cli.progress import open_progress
from quadlog.pipelines.executor.progress import BatchCounts, BatchLines, start_up, working_s


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
    monkeypatch.setenv("COLUMNS", "80")
    with open_progress(notes=False) as progress:
        progress.begin("ingest", None)
        progress.begin("filter", 4)
        for step in range(3):
            progress.advance(0.1 * step)
            progress._bars.refresh()
        progress.advance(0.4)
        for kernels in (1, 2):
            progress.compiled(kernels)
            progress._bars.refresh()
        progress.say("topic \x1b[31m/points")
        progress.note("a detail")
        progress.say(f"{'words ' * 13}at the end")
    drawn = screen.getvalue()
    assert all(words in drawn for words in ("3/4", "4/4", "real time", "0:00:0", "topic ", "2/? ", "kernels"))
    assert "a detail" not in drawn
    assert "words at\n  the end" in drawn.replace("\r", "")
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


def test_a_pipe_hears_where_a_long_replay_is(monkeypatch, capsys):
    monkeypatch.setattr("quadlog.pipelines.executor.progress.SAID_EVERY_S", 0.0)
    said = threading.Event()
    lines = BatchLines(lambda text: said.set() if text.startswith("filter 1/3, ") else None)
    with lines as progress:
        progress.begin("filter", 3)
        progress.advance(1.0)
        assert said.wait(5)


def test_the_clock_of_rates_stands_while_kernels_are_compiled(monkeypatch):
    monkeypatch.setattr(start_up, "seconds", 1e6)
    before_s = working_s()
    monkeypatch.setattr(start_up, "seconds", 2e6)
    assert working_s() < before_s - 1e5


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
