"""Pictures of the papers' tables."""

from __future__ import annotations

from quadlog.results import mpl
from quadlog.results.papers.table import TablePicture
from quadlog.results.view import Drawing


def drawn(name: str, alt: str, caption: str, drawing: Drawing) -> TablePicture:
    """The drawing as a picture of a table."""
    return TablePicture(name, alt, caption, mpl.render(drawing))
