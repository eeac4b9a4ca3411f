"""What an installation has: files, dependencies, the lock, the Python versions, and the names of `import quadlog`."""

from __future__ import annotations

import inspect
import re
import subprocess
import sys
import tomllib
import typing
from collections.abc import Iterable
from glob import glob
from importlib import import_module
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from setuptools import find_namespace_packages

import quadlog
from quadlog.cli.main import run

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]
LOCK = (ROOT / "requirements.lock").read_text().splitlines()


def requirements(texts: Iterable[str]) -> dict[str, Requirement]:
    return {canonicalize_name(each.name): each for each in map(Requirement, texts)}


def test_every_source_and_data_file_is_in_the_wheel():
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
    assert len(tree) > 200
    assert tree <= packed


def test_licences_of_vendored_files_are_named():
    vendored = {str(path.relative_to(ROOT)) for path in (ROOT / "quadlog").rglob("*LICENSE*")}
    assert {"LICENSE"} | vendored == set(PROJECT["license-files"])


def test_the_program_imports_what_a_plain_installation_has_and_all_of_it():
    names = {"PIL": "pillow", "foxglove": "foxglove-sdk", "mcap_protobuf": "mcap-protobuf-support", "yaml": "pyyaml"}
    names |= {
        "markupsafe": "jinja2",
        "pydantic_core": "pydantic",
        "google": "mcap-protobuf-support",
    }  # brought by these
    files = [path for top in ("quadlog", "cli", "pipelines") for path in (ROOT / top).rglob("*.py")]
    imports = re.compile(r"^ *(?:import (\w+)|from (\w+)[\w.]* import )", re.MULTILINE)
    tops = {top for path in files for found in imports.findall(path.read_text()) for top in found if top}
    imported = {canonicalize_name(names.get(top, top)) for top in tops - sys.stdlib_module_names - {"quadlog"}}
    declared = set(requirements(PROJECT["dependencies"])) - {"open3d-cpu"}
    extras = requirements(each for extra in ("s3", "cluster") for each in PROJECT["optional-dependencies"][extra])
    assert declared <= imported <= declared | set(extras)


def test_the_lock_pins_everything_within_the_declared_bounds():
    groups = {**PROJECT["optional-dependencies"], **PYPROJECT["dependency-groups"]}
    wanted = [*PROJECT["dependencies"], *(each for group in groups.values() for each in group)]
    pinned: dict[str, list[str]] = {}
    for line in LOCK:
        name, version = re.fullmatch(r"([\w.-]+)==([\w.]+)(?: ; .*)?", line).groups()  # no URL, no path, no option
        pinned.setdefault(canonicalize_name(name), []).append(version)
    for name, each in requirements(wanted).items():
        if name != "quadlog":
            assert all(each.specifier.contains(version) for version in pinned[name]), each
    hook = (ROOT / ".pre-commit-config.yaml").read_text()
    assert [f"rev: v{version}" for version in pinned["ruff"]] == re.findall(r"rev: v[\d.]+", hook)


def test_the_python_versions_promised_are_the_ones_declared():
    low, beyond = re.fullmatch(r">=3\.(\d+),<3\.(\d+)", PROJECT["requires-python"]).groups()
    minors = [str(minor) for minor in range(int(low), int(beyond))]
    assert re.findall(r"Python :: 3\.(\d+)", "\n".join(PROJECT["classifiers"])) == minors
    makefile = (ROOT / "Makefile").read_text()
    assert f"(3, {low}) <= sys.version_info < (3, {beyond})" in makefile
    assert re.findall(r"3\.(\d+)", re.search(r'"quadlog needs Python (.*?);', makefile)[1]) == minors
    workflow = (ROOT / ".github/workflows/ci.yml").read_text()
    assert re.findall(r'"3\.(\d+)"', workflow) == minors


@pytest.mark.parametrize(("minor", "is_taken"), [(10, False), (11, True), (13, True), (14, False)])
def test_make_refuses_other_pythons_with_a_hint(tmp_path, minor, is_taken):
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


def test_object_storage_without_its_extra_is_one_line_that_names_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "s3fs", None)
    monkeypatch.delitem(import_module("fsspec.registry")._registry, "s3", raising=False)
    assert run(["info", "s3://lab/walk.mcap"]) == 1
    assert re.fullmatch(r"quadlog: .*pip install 'quadlog\[s3\]'\n", capsys.readouterr().err)


def test_importing_quadlog_imports_nothing_else():
    code = "import sys\nbefore = set(sys.modules)\nimport quadlog\nprint(sorted(set(sys.modules) - before))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    new = {each.strip("' ") for each in done.stdout.strip("[]\n").split(",")}
    assert {each for each in new if each.startswith("quadlog")} == {"quadlog", "quadlog.version"}
    assert new.isdisjoint({"numpy", "pandas", "pyarrow", "pydantic", "click", "numba"})


@pytest.mark.parametrize("name", sorted(set(quadlog.__all__) - {"__version__"}))
def test_what_quadlog_offers_is_documented_and_typed(name):
    found = getattr(quadlog, name)
    assert name in dir(quadlog)
    assert inspect.getdoc(found)
    # Type checkers see the imports under TYPE_CHECKING; they name the same module as the lazy import does.
    assert re.search(
        rf"^    from {re.escape(quadlog._HOMES[name])} import .*\b{name}\b", inspect.getsource(quadlog), re.M
    )
    if inspect.isfunction(found):
        assert set(typing.get_type_hints(found)) == {*inspect.signature(found).parameters, "return"}
