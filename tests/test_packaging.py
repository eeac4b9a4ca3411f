"""What an installation holds: a file missing from it would vanish from the wheel while tests still pass."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from glob import glob
from pathlib import Path

import pytest
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
    assert len(tree) > 300
    assert tree <= packed


def test_every_dependency_is_explained_in_contributing():
    text = (ROOT / "CONTRIBUTING.md").read_text()
    section = text.split("## Dependencies")[1]
    for requirement in PYPROJECT["project"]["dependencies"]:
        name = re.split(r"[<>=;\s]", requirement)[0]
        assert re.search(rf"(^|[\s|(,]){re.escape(name)}([\s|),]|$)", section, re.MULTILINE), name


def test_the_python_versions_promised_are_the_ones_declared():
    low, beyond = re.fullmatch(r">=3\.(\d+),<3\.(\d+)", PYPROJECT["project"]["requires-python"]).groups()
    minors = [str(minor) for minor in range(int(low), int(beyond))]
    assert re.findall(r"Python :: 3\.(\d+)", "\n".join(PYPROJECT["project"]["classifiers"])) == minors
    needs = re.search(r"needs Python (.*?), make", (ROOT / "README.md").read_text())
    assert re.findall(r"3\.(\d+)", needs[1]) == minors
    makefile = (ROOT / "Makefile").read_text()
    assert f"(3, {low}) <= sys.version_info < (3, {beyond})" in makefile
    assert re.findall(r"3\.(\d+)", re.search(r'"quadlog needs Python (.*?);', makefile)[1]) == minors


@pytest.mark.parametrize(("minor", "is_taken"), [(10, False), (11, True), (13, True), (14, False)])
def test_make_refuses_other_pythons_with_a_hint(tmp_path: Path, minor: int, is_taken: bool) -> None:
    """With a Python that claims another version; the check comes before anything is installed."""
    python = tmp_path / "python"
    claim = f"import sys; sys.version_info = (3, {minor}, 0, 'final', 0); exec(sys.argv[1])"
    python.write_text(f'#!/bin/sh\nshift\nexec "{sys.executable}" -c "{claim}" "$@"\n')
    python.chmod(0o755)
    makefile = (ROOT / "Makefile").read_text() + "\ncheck:\n\t@$(check-python)\n"
    command = ["make", "-s", "-f", "-", "check", f"PYTHON={python}"]
    done = subprocess.run(command, input=makefile, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == is_taken, done.stderr
    assert is_taken or "quadlog needs Python 3.11, 3.12 or 3.13; try: make PYTHON=python3.12 check" in done.stderr
