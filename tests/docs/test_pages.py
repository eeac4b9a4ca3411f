"""README and docs/ as texts: links, anchors, paths, pictures, names of commands and options, and the plain words."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from quadlog.cli.main import COMMANDS, cli
from quadlog.errors import ExitCode

ROOT = Path(__file__).parents[2]
PAGES = ("README.md", "CONTRIBUTING.md", *sorted(f.relative_to(ROOT).as_posix() for f in (ROOT / "docs").rglob("*.md")))
TEXTS = {page: (ROOT / page).read_text() for page in PAGES}
PROSE = {page: re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE) for page, text in TEXTS.items()}
INLINE = sorted({code for text in PROSE.values() for code in re.findall(r"`([^`\n]+)`", text)})
OWN = re.compile(
    r"https://(?:github\.com/quadlog/quadlog/(?:blob|tree)|raw\.githubusercontent\.com/quadlog/quadlog)/main/"
)
README = TEXTS["README.md"]


def test_the_readme_is_short_and_can_be_read_without_a_checkout():
    assert len(README.splitlines()) <= 120
    assert len(README.split()) <= 1300
    assert [link for link in re.findall(r"\]\(([^)]+)\)", README) if not link.startswith("https://")] == []


def slugs(text: str) -> set[str]:
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).strip().replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES)
def test_every_link_and_anchor_leads_somewhere(page):
    for link in re.findall(r"\]\(([^)]+)\)", PROSE[page]) + re.findall(
        r"https://\S+quadlog/main/[^\s)>]+", TEXTS[page]
    ):
        path, _, anchor = OWN.sub("", link).partition("#")
        if "://" in path or path.startswith("mailto:"):
            continue
        target = ROOT / path if OWN.match(link) else (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), link
        assert not anchor or anchor in slugs(target.read_text()), link


@pytest.mark.parametrize("code", [code for code in INLINE if code.startswith(("quadlog ", "make "))])
def test_a_command_that_is_mentioned_exists(code):
    first, *words = (word for word in code.split() if "=" not in word)
    if first == "make":
        assert f"\n{words[0]}:" in (ROOT / "Makefile").read_text()
    elif words[0] not in ("--help", "--version", "COMMAND"):
        assert words[0] in COMMANDS
        with cli.make_context("quadlog", words[:1], resilient_parsing=True) as ctx:
            command = cli.get_command(ctx, words[0])
        assert {word for word in words[1:] if word.startswith("-")} <= {o for p in command.params for o in p.opts}


@pytest.mark.parametrize("code", [
    code for code in INLINE if re.match(r"(quadlog|cli|pipelines|docs|tests|fixtures|examples)/", code)
])  # fmt: skip
def test_a_path_that_is_mentioned_exists(code):
    assert any(ROOT.glob(re.sub(r"NAME|PACKAGE|FOLDER", "*", code).rstrip("/"))), code


def test_every_table_has_as_many_cells_in_each_row():
    for page, text in TEXTS.items():
        for table in re.findall(r"(?:^\|.*\n)+", text, re.MULTILINE):
            assert len({len(re.findall(r"(?<!\\)\|", row)) for row in table.splitlines()}) == 1, (page, table)


def test_tables_to_add_a_line_to_are_where_they_are_said_to_be():
    said = re.findall(r"`(\w+)` (?:in|of) `([\w/]+\.py)`", TEXTS["docs/adding.md"])
    assert len(said) >= 8
    for name, path in said:
        assert re.search(rf"^(?:def |class )?{name}\b", (ROOT / path).read_text(), re.MULTILINE), (name, path)


def test_every_command_and_exit_code_is_listed():
    page = TEXTS["docs/commands.md"]
    assert set(COMMANDS) <= set(re.findall(r"`([a-z-]+)", page))
    codes = re.findall(r"^\| (\d) \|", TEXTS["docs/troubleshooting.md"], re.MULTILINE)
    assert codes == [str(int(code)) for code in ExitCode]


def test_the_picture_of_the_house_names_what_is_there():
    picture = re.search(r"^```\n(.*?)^```$", TEXTS["docs/architecture.md"], re.DOTALL | re.MULTILINE)[1]
    tree = [path for top in ("quadlog", "cli", "pipelines", "docs") for path in (ROOT / top).rglob("*")]
    names = {path.name if path.is_dir() else path.stem for path in tree}
    assert set(re.findall(r"\b[a-z0-9]+(?:_[a-z0-9]+)+\b", picture)) - {"map_server"} <= names
    packages = {path.parent.name for path in tree if path.name == "__init__.py"}
    modules = {path.name for path in (ROOT / "quadlog").glob("*.py")} - {"__init__.py", "__main__.py", "version.py"}
    assert {name for name in packages | modules if name not in picture} == set()


@pytest.mark.parametrize("words", [
    r"\bis told\b", r"which is said", r"none of these", r"\bis had\b", r"\banew\b", r"\bamid\b", r"beside which",
    r"\bwhose \w+ stands\b", r"\btold apart\b",
])  # fmt: skip
def test_the_pages_are_written_plainly(words):
    generated = ("docs/troubleshooting.md", "docs/configuration.md", "docs/metrics.md")  # written from texts elsewhere
    assert [page for page, text in PROSE.items() if page not in generated and re.search(words, text)] == []
