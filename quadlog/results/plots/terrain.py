"""The ground as the lidar saw it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.results.plots import places, style
from quadlog.results.plots.run_data import RunData

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BAR_IN = 1.2  # the colour bar with its labels, down to −99.999 m


def draw_terrain(run: RunData) -> Figure | None:
    """Mean height of ground points per cell, in metres of `map`; cells without ground points stay empty."""
    from matplotlib.ticker import MaxNLocator

    ground = run.ground
    if ground is None:
        return None
    height_m, cell_m = ground.height_m, float(ground.cell_m)
    known_row, known_column = np.nonzero(np.isfinite(height_m))
    if not len(known_row):
        return None
    rows = slice(int(known_row.min()), int(known_row.max()) + 1)
    columns = slice(int(known_column.min()), int(known_column.max()) + 1)
    cut = height_m[rows, columns]
    left, bottom = float(ground.origin_m[0]) + columns.start * cell_m, float(ground.origin_m[1]) + rows.start * cell_m
    extent = (left, left + cut.shape[1] * cell_m, bottom, bottom + cut.shape[0] * cell_m)
    low_m, high_m = np.percentile(cut[np.isfinite(cut)], [1, 99])
    figure, axes = places.new_map(extent, BAR_IN, places.TITLE_IN)
    # At least 2 cm of range: sensor noise on a flat floor should look flat.
    image = axes.imshow(
        np.ma.masked_invalid(cut),
        origin="lower",
        extent=extent,
        cmap="cividis",
        zorder=style.ABOVE_GRID,
        vmin=float(low_m),
        vmax=float(max(high_m, low_m + 0.02)),
    )
    axes.set_title(
        f"{style.count(len(known_row))} cells of {cell_m:g} m; 98 % of heights within {high_m - low_m:.3f} m"
    )
    few = MaxNLocator(6, steps=[1, 2, 5, 10])  # such ticks have short labels
    places.add_bar(axes, image, "height of the ground (m)", extend="both", ticks=few)
    return figure
