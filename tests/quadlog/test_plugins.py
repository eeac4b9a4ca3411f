from __future__ import annotations

import os
import sys

import pytest

from quadlog.errors import QuadlogError
from quadlog.plugins import (
    DECODERS,
    PLANNERS,
    all_plugins,
    find_plugin,
    foreign_code,
    plugin_names,
)

SAYS = "raise RuntimeError('imported')\n"


def test_names_are_found_without_an_import(plugin_site, install):
    assert plugin_names(PLANNERS) == ()
    assert find_plugin(PLANNERS, "greedy", taken=False) is None
    points = {PLANNERS: {"zigzag": "loud:Zigzag", "arc": "loud:Arc"}, DECODERS: {"a_msgs/msg/B": "loud:decoder"}}
    install("quadlog-loud", "2.5", points, {"loud": SAYS})
    assert plugin_names(PLANNERS) == ("arc", "zigzag")
    owners = {(each.distribution, each.version) for each in all_plugins()}
    assert owners == {("quadlog-loud", "2.5")}
    found = [(each.kind, each.name) for each in all_plugins()]
    assert found == [("planner", "arc"), ("planner", "zigzag"), ("decoder", "a_msgs/msg/B")]
    assert "loud" not in sys.modules


@pytest.mark.parametrize(
    ("source", "cause"),
    [
        (SAYS, "RuntimeError: imported"),
        ("import no_such_module_anywhere\n", "ModuleNotFoundError: No module named 'no_such_module_anywhere'"),
        ("raise SystemExit('three\\nlines\\nlong')\n", "SystemExit: three lines long"),
        ("import os\nos._exit(0)\n", "SystemExit: os._exit(0)"),
        ("class E(BaseException):\n    pass\nraise E('gone')\n", "E: gone"),
        ("this is no python\n", "SyntaxError: "),
        ("class E(Exception):\n    __str__ = None\nraise E\n", "E: without a readable message"),
        ("other = 1\n", "AttributeError: "),
    ],
)
def test_an_import_error_is_one_line_with_distribution_and_cause(install, source, cause):
    install("quadlog-broken", "0.3", {PLANNERS: {"broken": "broken:Broken"}}, {"broken": source})
    plugin = find_plugin(PLANNERS, "broken", taken=False)
    assert plugin is not None
    with pytest.raises(QuadlogError) as raised:
        plugin.load()
    said = str(raised.value)
    assert said.startswith("planner broken of quadlog-broken 0.3: cannot be loaded: ")
    assert cause in said
    assert "\n" not in said
    assert raised.value.__cause__ is not None


def test_what_it_prints_goes_to_stderr(install, capsys):
    install("quadlog-loud", "2.5", {PLANNERS: {"prints": "prints:say"}}, {"prints": "print('imported')\nsay = print\n"})
    plugin = find_plugin(PLANNERS, "prints", taken=False)
    say = plugin.load()
    with plugin.doing("plan"):
        say("planned")
    assert capsys.readouterr() == ("", "imported\nplanned\n")


def test_a_name_of_two_is_refused_and_others_are_not(install):
    install("quadlog-one", "1.0", {PLANNERS: {"same": "one:Same", "other": "one:Other", "astar": "one:AStar"}})
    install("quadlog-two", "2.0", {PLANNERS: {"same": "two:Same"}})
    with pytest.raises(QuadlogError, match=r"same.*(one 1\.0, .*two 2\.0|two 2\.0, .*one 1\.0)"):
        find_plugin(PLANNERS, "same", taken=False)
    assert find_plugin(PLANNERS, "other", taken=False) is not None
    with pytest.raises(QuadlogError, match=r"planner astar: several have that name \(quadlog, quadlog-one 1\.0\)"):
        find_plugin(PLANNERS, "astar", taken=True)


def test_a_process_that_a_plugin_forks_may_end_and_an_interrupt_passes():
    with foreign_code(RuntimeError):
        child = os.fork()
        if child == 0:
            os._exit(7)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7
    with pytest.raises(KeyboardInterrupt), foreign_code(RuntimeError):
        raise KeyboardInterrupt
