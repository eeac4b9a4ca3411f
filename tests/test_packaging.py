"""The package list is written by hand; a package missing from it would vanish from the wheel while tests still pass."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def _packages_in_the_tree() -> set[str]:
    folders = {path.parent for top in ("quadlog", "cli", "pipelines") for path in (ROOT / top).rglob("*.py")}
    names = {".".join(folder.relative_to(ROOT).parts) for folder in folders}
    return {name if name.split(".")[0] == "quadlog" else f"quadlog.{name}" for name in names}


def test_every_package_is_on_the_list():
    assert set(PYPROJECT["tool"]["setuptools"]["packages"]) == _packages_in_the_tree()


def test_every_data_file_is_matched_by_a_pattern():
    patterns = PYPROJECT["tool"]["setuptools"]["package-data"]
    matched = {
        path
        for package, globs in patterns.items()
        for glob in globs
        for path in (ROOT / Path(*package.split("."))).glob(glob)
    }
    data = {
        path
        for path in (ROOT / "quadlog").rglob("*")
        if path.is_file() and path.suffix not in {".py", ".pyc", ".nbi", ".nbc"}
    }
    assert data <= matched


def test_every_dependency_is_explained_in_contributing():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    section = text.split("## Dependencies")[1]
    for requirement in PYPROJECT["project"]["dependencies"]:
        name = re.split(r"[<>=;\s]", requirement)[0]
        assert re.search(rf"(^|[\s|(,]){re.escape(name)}([\s|),]|$)", section, re.MULTILINE), name


def test_the_python_versions_promised_are_the_ones_declared():
    assert PYPROJECT["project"]["requires-python"] == ">=3.11,<3.14"
    assert "3.11" in (ROOT / "README.md").read_text()
