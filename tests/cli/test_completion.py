"""What a shell gets when the tab key is pressed, through the installed command's own entry point."""

from __future__ import annotations

import pytest
from click.shell_completion import BashComplete

from quadlog.cli.main import COMMANDS, cli
from quadlog.planning.planners import PLANNER_NAMES
from quadlog.plugins import CONTROLLERS
from quadlog.plugins import PLANNERS as GROUP
from quadlog.results import STAGES


def completed(typed):
    """Kind and word of what is offered for the line's last word; a space at its end begins another."""
    words = typed.split()
    last = "" if typed.endswith(" ") or not typed else words.pop()
    found = BashComplete(cli, {}, "quadlog", "_QUADLOG_COMPLETE").get_completions(words, last)
    return [(each.type, each.value) for each in found]


@pytest.mark.parametrize(
    ("typed", "choices"),
    [
        ("", COMMANDS),
        ("replay --until ", STAGES),
        ("replay --planner ", PLANNER_NAMES),
        ("compare-planners --leader mt", ["mt_d_star_lite"]),
        ("tables planning-e", ["planning-ea"]),
        ("simulate line --terrain 3", ["3cm"]),
        ("metrics --explain uwb_n", ["uwb_nis", "uwb_nees"]),
        ("metrics --fail-if uwb_n", ["uwb_nis", "uwb_nees"]),
        ("replay --set uwb.tag_", ["uwb.tag_height_m="]),
    ],
)
def test_choices(typed, choices):
    assert sorted(completed(typed)) == sorted(("plain", each) for each in choices)


@pytest.mark.parametrize(
    ("typed", "words"), [("info wa", []), ("replay -c wa", []), ("compare-planners f", ["forest:"])]
)
def test_files_are_left_to_the_shell_beside_words(typed, words):
    *found, (kind, last) = completed(typed)
    assert found == [("plain", each) for each in words]
    assert (kind in ("file", "dir"), last) == (True, typed.rpartition(" ")[2])


def test_planners_and_controllers_of_plugins_are_offered_and_not_imported(install):
    points = {GROUP: {"zigzag": "zig:Zigzag"}, CONTROLLERS: {"zag": "zig:Zag"}}
    install("quadlog-zig", "1.0", points, {"zig": "raise SystemExit(9)"})
    for words in ("replay --planner", "compare-planners --planner"):
        assert completed(f"{words} z") == [("plain", "zigzag")]
    for words in ("replay --controller", "simulate --controller"):
        assert completed(f"{words} z") == [("plain", "zag")]
