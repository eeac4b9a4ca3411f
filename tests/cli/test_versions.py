from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import click
import numpy
import pytest

from quadlog.cli.main import run
from quadlog.config.plugins import DECODERS, PLANNERS
from quadlog.version import __version__

BUILT_ON = ("daqp", "foxglove-sdk", "mcap", "mujoco", "numba", "numpy", "pandas", "pyarrow", "quadprog", "scipy")


def test_the_first_line_is_quadlogs_own_and_every_package_has_one(capsys):
    assert run(["--version"]) == 0
    first, *rest = capsys.readouterr().out.splitlines()
    assert first == f"quadlog, version {__version__}"
    told = dict(line.split() for line in rest)
    assert told["python"] == sys.version.split()[0]
    assert told["numpy"] == numpy.__version__
    assert {name: told[name] for name in BUILT_ON} == {name: version(name) for name in BUILT_ON}


def test_plugins_are_listed_and_not_imported(install, capsys):
    points = {PLANNERS: {"zigzag": "zig:Zigzag", "astar": "zig:A"}, DECODERS: {"a.B": "zig:b"}}
    install("quadlog-zig", "0.7", points, {"zig": "raise SystemExit(9)"})
    assert run(["--version"]) == 0
    assert capsys.readouterr().out.splitlines()[-3:] == [
        "planner astar: quadlog-zig 0.7",
        "planner zigzag: quadlog-zig 0.7",
        "decoder a.B: quadlog-zig 0.7",
    ]


@pytest.mark.parametrize("package", ["numpy", "mujoco", "numba", "foxglove", "mcap"])
def test_no_package_is_imported_for_its_version(package):
    code = f"import sys\nfrom quadlog.cli.main import run\nrun(['--version'])\nsys.exit({package!r} in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_completing_asks_for_no_version():
    """The option's callback runs while a command line is completed, too."""
    from quadlog.cli.main import print_versions

    context = click.Context(click.Command("quadlog"), resilient_parsing=True)
    print_versions(context, click.Option(["--version"]), True)
