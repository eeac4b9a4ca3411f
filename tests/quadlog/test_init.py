"""`import quadlog`: nothing is paid for that is not used, and what is offered is documented."""

from __future__ import annotations

import inspect
import subprocess
import sys
import typing

import pytest

import quadlog


def test_importing_it_imports_nothing_else():
    code = "import sys\nbefore = set(sys.modules)\nimport quadlog\nprint(sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    new = {each.strip("' ") for each in done.stdout.strip("[]\n").split(",")}
    assert {each for each in new if each.startswith("quadlog")} == {"quadlog", "quadlog.version"}
    assert new.isdisjoint({"numpy", "pandas", "pyarrow", "pydantic", "click", "numba"})


def test_everything_offered_is_there_and_documented():
    assert set(quadlog.__all__) <= set(dir(quadlog))
    for name in quadlog.__all__:
        found = getattr(quadlog, name)
        assert name == "__version__" or inspect.getdoc(found), name


def test_type_checking_imports_match_lazy_imports():
    """The imports under TYPE_CHECKING and the table of homes name the same objects."""
    text = inspect.getsource(quadlog)
    for name, home in quadlog._HOMES.items():
        assert any(line.strip().startswith(f"from {home} import") and name in line for line in text.splitlines()), name
        assert getattr(sys.modules[getattr(quadlog, name).__module__], name) is getattr(quadlog, name)
    assert set(quadlog._HOMES) == set(quadlog.__all__) - {"__version__"}


def test_signatures_are_typed():
    for function in (quadlog.replay, quadlog.load_run, quadlog.open_recording):
        assert set(typing.get_type_hints(function)) == {*inspect.signature(function).parameters, "return"}


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="module 'quadlog' has no attribute 'nothing'"):
        _ = quadlog.nothing
