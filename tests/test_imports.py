"""What imports what, as installed: no circle of files, and no arrow upwards."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FLOORS = {"pipelines": 1, "cli": 2, "__main__": 2}
"""Above all others, which are floor 0."""


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    parts = parts if parts[0] == "quadlog" else ("quadlog", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {module_of(path): path for room in ("quadlog", "pipelines", "cli") for path in (ROOT / room).rglob("*.py")}


def is_for_types(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


def imported(nodes: list[ast.stmt]) -> Iterator[str]:
    """Modules of quadlog that are imported when a file is; not what its functions import, nor what types need."""
    for node in nodes:
        if is_for_types(node):
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                within = f"{node.module}.{alias.name}"
                yield within if within in SOURCES else node.module
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, (ast.If, ast.Try)):
            yield from imported(node.body + node.orelse)


def everything_imported(path: Path) -> set[str]:
    """The same with what functions import."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
    return found & SOURCES.keys()


GRAPH = {name: set(imported(ast.parse(path.read_text()).body)) & SOURCES.keys() for name, path in SOURCES.items()}


def circle() -> list[str]:
    """The modules of one circle, empty where there is none."""
    done: set[str] = set()

    def look(name: str, way: list[str]) -> list[str]:
        if name in way:
            return way[way.index(name) :]
        if name in done:
            return []
        for other in sorted(GRAPH[name]):
            if found := look(other, [*way, name]):
                return found
        done.add(name)
        return []

    return next((found for name in sorted(GRAPH) if (found := look(name, []))), [])


def test_no_circle() -> None:
    assert circle() == []


def floor(name: str) -> int:
    return FLOORS.get(name.split(".")[1] if "." in name else "", 0)


def test_no_arrow_points_upwards() -> None:
    upwards = [
        (name, other)
        for name, path in SOURCES.items()
        for other in everything_imported(path)
        if floor(other) > floor(name) and name != "quadlog"
    ]
    assert upwards == []
