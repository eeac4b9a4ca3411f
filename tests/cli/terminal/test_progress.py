from __future__ import annotations

import io

from rich.console import Console

from quadlog.cli.terminal import progress_bars as progress


def test_bars_show_stages_rates_and_harmless_words(monkeypatch):
    """Drawn on a terminal of our own: every stage ends full, and a topic's escape sequence is not obeyed."""
    screen = io.StringIO()
    bars = progress.Bars()
    bars._bars.live.console = Console(file=screen, force_terminal=True, width=120)
    with bars:
        bars.begin("ingest", None)
        bars.begin("filter", 3)
        for step in range(3):
            bars.advance(0.1 * step)
        bars.say("topic \x1b[31m/points")
    drawn = screen.getvalue()
    assert "1/1" in drawn
    assert "3/3" in drawn
    assert "real time" in drawn
    assert "\x1b[31m/points" not in drawn


def test_a_pipe_gets_words_only(capsys):
    with progress.open_progress() as silent:
        silent.begin("filter", 3)
        silent.advance(1.0)
        silent.say("robot position from uwb")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "robot position from uwb\n"
