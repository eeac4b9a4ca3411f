"""Distributions that add planners and decoders to quadlog, as an installer would leave them on the path."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from quadlog import plugins

Installer = Callable[..., Path]


def write_distribution(
    site: Path,
    name: str,
    version: str,
    entry_points: Mapping[str, Mapping[str, str]],
    modules: Mapping[str, str],
) -> Path:
    """A dist-info folder and modules in `site`, from which `importlib.metadata` and `import` find them."""
    info = site / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in points.items())
        for group, points in entry_points.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))
    for module, text in modules.items():
        (site / f"{module}.py").write_text(text)
    return info


def forget_plugins() -> None:
    """What was found on the path until now."""
    plugins._installed.cache_clear()
    if "quadlog.recordings.decoding" in sys.modules:
        sys.modules["quadlog.recordings.decoding"].plugged_decoder.cache_clear()  # type: ignore[attr-defined]


@pytest.fixture
def plugin_site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path, for this test, whose distributions are found; subprocesses find them too."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("PYTHONPATH", str(site))
    forget_plugins()
    yield site
    forget_plugins()
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(str(site)):
            del sys.modules[name]


@pytest.fixture
def install(plugin_site: Path) -> Installer:
    """Installs a distribution: (name, version, {group: {entry point: object}}, {module: source})."""

    def install(
        name: str,
        version: str = "1.0",
        entry_points: Mapping[str, Mapping[str, str]] = {},
        modules: Mapping[str, str] = {},
    ) -> Path:
        info = write_distribution(plugin_site, name, version, entry_points, modules)
        forget_plugins()
        return info

    return install
