from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

import quadlog
from quadlog import pipelines
from quadlog.pipelines.tables import make_tables as module
from quadlog.pipelines.tables.make_tables import code_digest


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """A package of three files, with its pipelines beside it as in a checkout."""
    for name in ("code/a.py", "code/cli/b.py", "beside/c.py"):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(name)
    place(monkeypatch, tmp_path / "code", tmp_path / "beside")
    return tmp_path


def place(monkeypatch, code: Path, beside: Path) -> None:
    monkeypatch.setattr(module, "quadlog", SimpleNamespace(__name__="quadlog", __path__=[str(code)]))
    monkeypatch.setattr(module, "pipelines", SimpleNamespace(__name__="quadlog.pipelines", __path__=[str(beside)]))


@pytest.mark.parametrize("name", ["code/a.py", "beside/c.py", "code/new.py"])
def test_any_change_of_a_source_is_seen(sources, name):
    before = code_digest()
    (sources / name).write_text("other")
    assert code_digest() != before


def test_a_file_that_moved_or_went_is_seen(sources):
    before = code_digest()
    (sources / "code/a.py").rename(sources / "code/d.py")
    moved = code_digest()
    (sources / "code/d.py").unlink()
    assert len({before, moved, code_digest()}) == 3


def test_the_command_line_and_other_files_change_nothing(sources):
    before = code_digest()
    (sources / "code/cli/b.py").write_text("other")
    (sources / "code/a.nbi").write_text("compiled")
    assert code_digest() == before


def test_installed_it_is_the_same_as_in_a_checkout(sources, monkeypatch):
    before = code_digest()
    shutil.copytree(sources / "code", sources / "site" / "quadlog")
    shutil.copytree(sources / "beside", sources / "site" / "quadlog" / "pipelines")
    place(monkeypatch, sources / "site" / "quadlog", sources / "site" / "quadlog" / "pipelines")
    assert code_digest() == before


def test_another_version_of_a_package_is_seen(sources, monkeypatch):
    before = code_digest()
    monkeypatch.setattr(module, "package_versions", lambda: {"numpy": "0.1"})
    assert code_digest() != before


def test_the_packages_are_those_that_are_imported():
    assert module.quadlog is quadlog
    assert module.pipelines is pipelines
    assert len(code_digest()) == 64
    assert {"numpy", "scipy", "numba", "mujoco", "matplotlib"} <= set(module.package_versions())
