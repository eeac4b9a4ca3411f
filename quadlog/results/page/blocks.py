"""One page for everything: a list of blocks, rendered by templates/page.html.jinja into one file that opens offline.

Names of topics, files and metrics come from recordings and users and are not trusted: all text is escaped, nothing is
fetched, and only the scripts and styles of this package run, by their hashes.
"""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jinja2
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup

from quadlog.results.page.pack import Pack
from quadlog.results.record import SavedMetric
from quadlog.results.text import NONE, Bound, State, interval_text, state_of, value_text
from quadlog.results.view import Moment
from quadlog.storage.atomic_write import write_whole
from quadlog.version import __version__

_STYLES = ("vendor/uPlot.min.css", "app.css")
_SCRIPTS = ("vendor/uPlot.iife.min.js", "unpack.js", "scene.js", "controls.js", "curves.js", "start.js")


class Sentence(NamedTuple):
    """A line of the verdict: its subject in a word or two, and one sentence."""

    subject: str
    text: str
    state: State = ""


class Verdict(NamedTuple):
    """What came out, in about four sentences with a coloured dot each, worst first."""

    lines: Sequence[Sentence]


class Notes(NamedTuple):
    """A box of lines that a reader must not miss: losses, warnings."""

    title: str
    lines: Sequence[str]
    state: State = "warn"


class Column(NamedTuple):
    """A column of a table. number: aligned to the right. wide: left out on a phone. sorts: a sortable table by it."""

    name: str
    number: bool = False
    wide: bool = False
    help: str = ""
    sorts: bool = True


class Cell(NamedTuple):
    """A cell. value: what its column is sorted by, if not the text. below: a smaller second line.

    bar: where a bar begins and ends, and its interval, in percent of the column. track: left, top, width and height of
    a picture, and its polylines (colour, points), a point given twice being a mark. best: the best value of its row.
    """

    text: str
    value: float | str | None = None
    below: str = ""
    href: str = ""
    state: State = ""
    code: bool = False
    seconds: float | None = None
    bar: tuple[float, float, float, float] | None = None
    track: tuple[str, Sequence[tuple[str, str]]] | None = None
    best: bool = False


class Cards(NamedTuple):
    """Tiles: a title, and names with their meaning below, each beside a value with its interval or bound below."""

    cards: Sequence[tuple[str, Sequence[tuple[Cell, Cell]]]]


def metric_cell(name: str, of: SavedMetric | None, bound: Bound | None = None, digits: int = 3) -> Cell:
    """A value with its 95 % interval below, coloured by its bound, and without one by what is usual."""
    if of is None:
        return Cell(NONE) if bound is None else Cell("not measured", state="bad")
    interval = interval_text(name, of.interval, of.unit)
    return Cell(value_text(name, of.value, of.unit, digits), of.value, interval, state=state_of(name, of, bound))


class Table(NamedTuple):
    """Rows of cells under a title. folded: first row shown only on demand. command: shown for the rows that a reader
    chooses, which can be filtered, too; it takes the values of their first cells.
    """

    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    name: str
    note: str = ""
    sortable: bool = False
    folded: int | None = None
    title: str = ""
    command: str = ""


class Drawn(NamedTuple):
    """A drawing of the page's pack: panels of curves, or a scene, which has a player if it moves.

    start: instant of the first view. charts: curves on the time axis of a scene, in a column beside it.
    """

    name: str
    title: str = ""
    caption: str = ""
    moments: Sequence[Moment] = ()
    start: float | None = None
    charts: Sequence[Any] = ()


class Text(NamedTuple):
    """A paragraph, or lines of code."""

    text: str
    code: bool = False


class Details(NamedTuple):
    """Blocks shown on demand."""

    summary: str
    blocks: Sequence[Any]


class Section(NamedTuple):
    """Blocks under a heading; without a title they come first and are not in the contents. hint: not printed."""

    title: str
    blocks: Sequence[Any]
    text: str = ""
    hint: str = ""

    @property
    def name(self) -> str:
        """The anchor of the section."""
        return "-".join("".join(c if c.isalnum() else " " for c in self.title.lower()).split())


@dataclass(frozen=True, slots=True)
class Page:
    """A page of the sections that have blocks.

    facts: short texts below the title. status: the pill beside the title, in words and colour. links: (text, address)
    of pages above and beside this one.
    """

    title: str
    sections: Sequence[Section]
    facts: Sequence[str] = ()
    status: tuple[str, State] = ("", "")
    links: Sequence[tuple[str, str]] = ()
    pack: Pack = field(default_factory=Pack)


def write_page(path: Path, page: Page) -> Path:
    """The page as one file; the same blocks give the same bytes. Raises CannotWrite."""
    write_whole(path, render(page))
    return path


def render(page: Page) -> bytes:
    """The page in UTF-8."""
    scripts = [_own_file(name) for name in (*(_SCRIPTS if page.pack else ()), "table.js")]
    styles = [_own_file(name) for name in _STYLES]
    policy = f"default-src 'none'; style-src {_hashes(styles)}; script-src {_hashes(scripts)}; "
    policy += "base-uri 'none'; form-action 'none'"
    # Only files of this package and escaped data are inserted as they are.
    inside = {"styles": list(map(Markup, styles)), "scripts": list(map(Markup, scripts))}
    data = htmlsafe_json_dumps(page.pack.finish(), separators=(",", ":"), allow_nan=False) if page.pack else None
    template = _environment().get_template("page.html.jinja")
    text = template.render(page=page, policy=policy, data=data, version=__version__, **inside)
    # Names may contain lone surrogates, which cannot be encoded.
    return text.encode("utf-8", "replace")


@cache
def _environment() -> jinja2.Environment:
    blanks: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True, "keep_trailing_newline": True}
    loader = jinja2.FunctionLoader(_own_file)
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, **blanks)
    environment.filters["kind"] = lambda block: type(block).__name__.lower()
    environment.filters["instant"] = lambda seconds: f"#t={seconds:.3f}"
    return environment


@cache
def _own_file(name: str) -> str:
    return (resources.files("quadlog.results.page") / "templates" / name).read_text(encoding="utf-8")


def _hashes(texts: Sequence[str]) -> str:
    digests = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in texts)
    return " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"
