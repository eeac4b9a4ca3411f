"""What an installation holds: a file missing from it would vanish from the wheel while tests still pass."""

from __future__ import annotations

import re
import tomllib
from glob import glob
from pathlib import Path

from setuptools import find_namespace_packages

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())


def test_every_source_and_data_file_is_in_the_wheel() -> None:
    setuptools = PYPROJECT["tool"]["setuptools"]
    patterns = setuptools["package-data"]["*"]
    packages = find_namespace_packages(ROOT, include=setuptools["packages"]["find"]["include"])
    globs = [f"{ROOT / package.replace('.', '/')}/{pattern}" for package in packages for pattern in ("*.py", *patterns)]
    packed = {Path(path) for pattern in globs for path in glob(pattern, recursive=True)}  # noqa: PTH207 (as setuptools)
    tree = {
        path
        for top in ("quadlog", "quadlog/cli", "quadlog/pipelines")
        for path in (ROOT / top).rglob("*")
        if path.is_file() and path.suffix not in {".pyc", ".nbi", ".nbc"}
    }
    assert len(tree) > 400
    assert tree <= packed


def test_every_dependency_is_explained_in_contributing():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    section = text.split("## Dependencies")[1]
    for requirement in PYPROJECT["project"]["dependencies"]:
        name = re.split(r"[<>=;\s]", requirement)[0]
        assert re.search(rf"(^|[\s|(,]){re.escape(name)}([\s|),]|$)", section, re.MULTILINE), name


def test_the_python_versions_promised_are_the_ones_declared():
    assert PYPROJECT["project"]["requires-python"] == ">=3.11,<3.14"
    assert "3.11" in (ROOT / "README.md").read_text()
