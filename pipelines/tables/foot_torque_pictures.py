"""Pictures of the table foot-torque: Fig. 3, and what tips the body over a stance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from quadlog.locomotion.dh_leg import KNEE_BEHIND
from quadlog.locomotion.diagonal_moment import LEFT_FORE_RIGHT_HIND, RIGHT_FORE_LEFT_HIND
from quadlog.pipelines.tables import foot_torque_figures as figures
from quadlog.results.plots import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

JOINTS = {"τ1, abduction": style.ROBOT, "τ2, hip": style.TARGET, "τ3, knee": style.PLAN}


def draw_torques() -> Figure:
    """The three torques over a stance: one leg's mass on the foot, and half of the body's."""
    figure = style.new_figure(3.8)
    panels = figure.subplots(1, 2)
    for panel, carried_kg in zip(panels, (figures.LEG_KG, figures.HALF_BODY_KG), strict=True):
        torques = figures.torques_of(figures.RIGHT, KNEE_BEHIND, carried_kg)
        _along_stance(panel, figures.STRIDE_M)
        ahead_mm = 1e3 * figures.feet_of(figures.RIGHT)[:, 0]
        for (label, color), torque in zip(JOINTS.items(), torques.T, strict=True):
            panel.plot(ahead_mm, torque, color=color, label=label)
        panel.axhline(0.0, color=style.ROBOT, linestyle="--", label="τ1, as printed")
        panel.set_title(f"{carried_kg:g} kg on the foot")
    panels[0].set_ylabel("torque (N m)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def draw_tipping() -> Figure:
    """Gravity's moment over a stance: all of it, and its parts about x and y, for both pairs."""
    figure = style.new_figure(3.8)
    panels = figure.subplots(1, 2, sharey=True)
    pairs = {"left fore, right hind": LEFT_FORE_RIGHT_HIND, "right fore, left hind": RIGHT_FORE_LEFT_HIND}
    for panel, (called, pair) in zip(panels, pairs.items(), strict=True):
        ahead_m, moments = figures.gravity_over_stance(pair)
        _along_stance(panel, figures.WALK_STRIDE_M)
        total = np.linalg.norm(moments, axis=1) * np.sign(moments[:, 1])
        lines = {"about the diagonal": total, "part about x": moments[:, 0], "part about y": moments[:, 1]}
        for (label, line), color in zip(lines.items(), (style.BLACK, style.ROBOT, style.TARGET), strict=True):
            panel.plot(1e3 * ahead_m, line, color=color, label=label)
        panel.plot(0.0, np.interp(0.0, -ahead_m, total), "o", color=style.BLACK, markersize=6, label="eq. 8, corrected")
        panel.set_title(called)
    panels[0].set_ylabel("moment (N m)")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _along_stance(panel: Axes, stride_m: float) -> None:
    """Time goes to the right: from a foot ahead to one behind."""
    panel.set_xlim(500 * stride_m, -500 * stride_m)
    panel.set_xlabel("foot ahead of the hip (mm)")
