from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

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


def test_any_change_of_a_source_or_package_is_seen(sources, monkeypatch):
    digests = [code_digest()]
    for name in ("code/a.py", "beside/c.py", "code/new.py"):
        (sources / name).write_text("other")
        digests.append(code_digest())
    (sources / "code/a.py").rename(sources / "code/d.py")
    digests.append(code_digest())
    monkeypatch.setattr(module, "package_versions", lambda: {"numpy": "0.1"})
    assert len({*digests, code_digest()}) == 6


def test_the_command_line_other_files_and_where_it_lies_change_nothing(sources, monkeypatch):
    before = code_digest()
    (sources / "code/cli/b.py").write_text("other")
    (sources / "code/a.nbi").write_text("compiled")
    shutil.copytree(sources / "code", sources / "site" / "quadlog")
    shutil.copytree(sources / "beside", sources / "site" / "quadlog" / "pipelines")
    assert code_digest() == before
    place(monkeypatch, sources / "site" / "quadlog", sources / "site" / "quadlog" / "pipelines")
    assert code_digest() == before
