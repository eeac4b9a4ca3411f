from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from quadlog.results.plots.control import draw_displacement, draw_euler_angles
from quadlog.results.plots.run_data import RunData
from quadlog.results.run.tables import TABLES, read_table, write_table


def _trotted(run: Path) -> RunData:
    control = read_table(run, "control")
    ticks = np.arange(len(control["t_ns"]))
    control |= {name: 0.1 * ticks + k for k, name in enumerate(("x_m", "y_m", "z_m"))}
    control |= {name: 0.01 * np.sin(ticks + k) for k, name in enumerate(("roll_rad", "pitch_rad", "yaw_rad"))}
    write_table(run / "control.parquet", TABLES["control"], control)
    record = RunData(run).record
    return RunData(run, dataclasses.replace(record, options={"course": "trot-32s", "controller": "baseline"}))


def test_places_and_angles_are_drawn_in_the_paper_s_units(tiny_run: Path) -> None:
    run = _trotted(tiny_run)
    control = run.table("control")
    assert control is not None
    wanted = {
        draw_displacement: [control["x_m"], 1e3 * control["y_m"], 1e3 * control["z_m"]],
        draw_euler_angles: [np.degrees(control[name]) for name in ("roll_rad", "pitch_rad", "yaw_rad")],
    }
    for draw, columns in wanted.items():
        figure = draw(run)
        assert figure is not None
        for panel, column in zip(figure.axes, columns, strict=True):
            (line,) = panel.lines
            np.testing.assert_allclose(line.get_ydata(), column)


def test_other_walks_have_neither(tiny_run: Path) -> None:
    run = RunData(tiny_run)
    assert draw_displacement(run) is None
    assert draw_euler_angles(run) is None
