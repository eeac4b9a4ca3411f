"""HTML pages that are safe to open: text is escaped, nothing is fetched, only quadlog's styles and scripts run."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Sequence
from functools import cache
from importlib import resources
from typing import Any

import jinja2
from markupsafe import Markup

from quadlog.results.text.numbers import count, short

_TEMPLATES = "quadlog.results.page", "templates"


def render_page(template: str, scripts: Sequence[str] = (), styles: Sequence[str] = (), **values: Any) -> bytes:
    """The page made from templates/TEMPLATE, in UTF-8, with report.css and these scripts and styles inside, in order.

    Names of topics come from recordings, which are not trusted: text is escaped, and the Content-Security-Policy
    allows only these styles and scripts, by hash, pictures inside the page, and no requests.
    """
    css, code = [[_own_file(name) for name in names] for names in (("report.css", *styles), scripts)]
    policy = (
        f"default-src 'none'; img-src data:; style-src {_hashes(css)}; script-src {_hashes(code)}; "
        "base-uri 'none'; form-action 'none'"
    )
    # Only files of this package are inserted unescaped.
    inside = {"styles": [Markup(text) for text in css], "scripts": [Markup(text) for text in code]}  # noqa: S704
    text = _environment().get_template(template).render(policy=policy, **inside, **values)
    # JSON may contain lone surrogates, which cannot be encoded.
    return text.encode("utf-8", "replace")


def format_number(value: float) -> str:
    """Four significant digits; whole numbers in full, with thin spaces between thousands."""
    if float(value).is_integer() and abs(value) < 1e15:
        return count(int(value)).replace("-", "\u2212")
    return short(value).replace("-", "\u2212")


def format_metres(value: float | None) -> str:
    """To the millimetre, with a true minus; a dash for no value."""
    return "–" if value is None else f"{round(value, 3) + 0.0:.3f}".replace("-", "\u2212")


def format_share(value: float | None) -> str:
    """A share as a percentage; a dash for no value."""
    return "–" if value is None else f"{100 * value:.1f}\u202f%"


def format_bytes(size: int) -> str:
    """A file's size in decimal units."""
    value = float(size)
    for unit in ("bytes", "kB", "MB", "GB"):
        if value < 1000:
            return f"{value:.3g} {unit}"
        value /= 1000
    return f"{value:.3g} TB"


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_own_file),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["number"] = format_number
    environment.filters["bytes"] = format_bytes
    environment.filters["metres"] = format_metres
    environment.filters["share"] = format_share
    return environment


@cache
def _own_file(name: str) -> str:
    package, folder = _TEMPLATES
    return (resources.files(package) / folder / name).read_text(encoding="utf-8")


def _hashes(texts: Sequence[str]) -> str:
    """Content-Security-Policy source list of these texts."""
    digests = (base64.b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in texts)
    return " ".join(f"'sha256-{digest}'" for digest in digests) or "'none'"
