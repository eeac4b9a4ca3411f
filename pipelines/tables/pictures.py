"""Pictures of the tables."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from quadlog.results.papers.table import TablePicture
from quadlog.results.plots.style import render_png

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def drawn(name: str, alt: str, caption: str, draw: Callable[[], Figure | None]) -> TablePicture:
    """The picture that `draw` makes, which must be one."""
    png = render_png(draw)
    assert png is not None
    return TablePicture(name, alt, caption, png)
