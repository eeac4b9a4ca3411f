"""Messages and docstrings of public names are plain English: words that were weeded out do not come back."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
FILES = sorted(path for top in ("quadlog", "cli", "pipelines") for path in (ROOT / top).rglob("*.py"))
PAGES = sorted(
    path for kind in ("jinja", "js") for path in (ROOT / "quadlog").rglob(f"*.{kind}") if "vendor" not in path.parts
) + sorted([*(ROOT / "docs").rglob("*.md"), *ROOT.glob("*.md")])
WEEDED = re.compile(
    r"\b(?:told|said)\b(?!:)|(?<!`)\btells?\b|\b(?:anew|amid|whoever)\b|\bspeaks? (?:of|for)\b"
    r"|\b(?:is|was|were|are|be|been) had\b|which is said|none of these|beside which|is none of|nowhere on"
    r"|\b(?:of|for|about|around|beside|behind|at|than|what|how) each(?=[.,;:)!?]|\s*\Z| (?:that|is|are|has|was)\b)"
    r"|[.:;(] each (?:is|are|has|was|lies)\b",
    re.IGNORECASE,
)
DOCUMENTED = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef


def weeded(text: str) -> list[str]:
    return [text[max(0, found.start() - 30) : found.end() + 20] for found in WEEDED.finditer(text)]


def texts(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Line and text of all that may be printed, and of the docstrings of public names."""
    hidden = set()
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and getattr(node, "name", "").startswith("_"):
            hidden |= {id(each) for each in ast.walk(node) if isinstance(each, DOCUMENTED)}
    docstrings = set()
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
            docstrings.add(id(node.body[0].value))
            if id(node) not in hidden:
                yield node.body[0].lineno, node.body[0].value.value
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.lineno, node.value if " " in node.value else ""


def test_messages_and_public_docstrings_are_plain():
    found = [
        f"{path.relative_to(ROOT)}:{line}: {words}"
        for path, source in ((path, path.read_text()) for path in FILES)
        if WEEDED.search(source)  # parsing takes longer
        for line, text in texts(ast.parse(source))
        for words in weeded(text)
    ]
    assert found == []


def test_pages_are_plain():
    assert [f"{path.name}: {words}" for path in PAGES for words in weeded(path.read_text())] == []
