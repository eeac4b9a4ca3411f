"""Figures of a run, drawn from its saved results only: one file per family, each `draw_x(run) -> Figure | None`."""
