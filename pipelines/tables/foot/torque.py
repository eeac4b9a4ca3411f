"""The table foot-torque: what tips the body over a stance, by the paper's moment and by whole-body dynamics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from quadlog.control.locomotion.leg_dynamics import (
    KNEE_BEHIND,
    KNEE_IN_FRONT,
    LEFT_FORE_RIGHT_HIND,
    RIGHT_FORE_LEFT_HIND,
    diagonal_m,
    diagonal_moment,
)
from quadlog.control.locomotion.robot import GRAVITY_MPS2
from quadlog.messages import Float
from quadlog.pipelines.tables.foot import torque_model as figures
from quadlog.pipelines.tables.intervals import claim, compare
from quadlog.pipelines.tables.pictures import drawn
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, TablePicture
from quadlog.results.view import Panel, Series, look

BEHIND = "foot behind the hip (mm)"


def torque_panels() -> list[Panel]:
    """The three torques over a stance: one leg's mass on the foot, and half of the body's."""
    behind_mm = -1e3 * figures.feet_of(figures.RIGHT)[:, 0]
    panels = []
    for carried_kg in (figures.LEG_KG, figures.HALF_BODY_KG):
        torques = figures.torques_of(figures.RIGHT, KNEE_BEHIND, carried_kg)
        lines = dict(zip(("τ1, abduction", "τ2, hip", "τ3, knee"), torques.T, strict=True))
        lines["τ1, as printed"] = np.zeros(len(behind_mm))
        panels.append(_panel(f"torque, {carried_kg:g} kg on the foot (N m)", behind_mm, lines))
    return panels


def tipping_panels() -> list[Panel]:
    """Gravity's moment over a stance: all of it, and its parts about x and y, for both pairs."""
    panels = []
    pairs = {"left fore, right hind": LEFT_FORE_RIGHT_HIND, "right fore, left hind": RIGHT_FORE_LEFT_HIND}
    for called, pair in pairs.items():
        ahead_m, moments = figures.gravity_over_stance(pair)
        total = np.linalg.norm(moments, axis=1) * np.sign(moments[:, 1])
        lines = {"about the diagonal": total, "part about x": moments[:, 0], "part about y": moments[:, 1]}
        panels.append(_panel(f"moment, {called} (N m)", -1e3 * ahead_m, lines))
    return panels


def _panel(what: str, behind_mm: Float, lines: Mapping[str, Float]) -> Panel:
    """Time goes to the right: from a foot ahead to one behind."""
    series = [Series(label, x=behind_mm, y=line, **look(number)) for number, (label, line) in enumerate(lines.items())]
    return Panel(what, series, BEHIND)


PEAKS_MM = (5, 10, 20)
PAIRS = {"left fore and right hind": LEFT_FORE_RIGHT_HIND, "right fore and left hind": RIGHT_FORE_LEFT_HIND}


def torque_group() -> RowGroup:
    """Fig. 3, and what it would be with another leg or the body's weight."""
    leg = figures.torques_of(figures.RIGHT, KNEE_BEHIND, figures.LEG_KG)
    rows = [
        compare(
            "tau 1, abduction (N m)",
            0.0,
            0.01,
            float(leg[0, 0]),
            note="Constant.",
            why_not="By eqs 5 and 6 it is -P_y f_z = L1 m g: the foot stands L1 beside the abduction axis.",
        ),
        *_signs("hip's torque, tau 2", leg[:, 1], False),
        PaperRow("tau 2, hip, at touch-down (N m)", float(leg[0, 1]), note="Printed as a curve only."),
        PaperRow("tau 2, hip, at lift-off (N m)", float(leg[-1, 1]), note="Printed as a curve only."),
        PaperRow("tau 3, knee, at touch-down (N m)", float(leg[0, 2])),
        PaperRow("tau 3, knee, at lift-off (N m)", float(leg[-1, 2])),
        PaperRow("left leg: tau 1 (N m)", float(figures.torques_of(1.0, KNEE_BEHIND, figures.LEG_KG)[0, 0])),
        *_extremes("knee in front: tau 3", figures.torques_of(figures.RIGHT, KNEE_IN_FRONT, figures.LEG_KG)[:, 2]),
        PaperRow("f_z, one leg's mass (N)", float(figures.ground_force(figures.LEG_KG)[2]), note="As in Fig. 3."),
        PaperRow("f_z, half of 10 kg (N)", float(figures.ground_force(figures.HALF_BODY_KG)[2]), note="As in a trot."),
    ]
    body = figures.torques_of(figures.RIGHT, KNEE_BEHIND, figures.HALF_BODY_KG)
    rows.append(PaperRow("half of 10 kg: tau 1 (N m)", float(body[0, 0])))
    for joint in (2, 3):
        rows += _extremes(f"half of 10 kg: tau {joint}", body[:, joint - 1])
    text = (
        "The right fore leg of Table 2, knee behind, from 25 mm ahead of its hip to 25 mm behind: L1 0.07, L2 = L3 = "
        "0.21, height 0.2, stride 0.05 m, f = (m a, 0, m g), links without mass. The paper takes one leg's mass, 0.5 "
        "kg, for m: so little is on no foot. Two legs of a trot carry the body, with section 4's 10 kg ten times as "
        "much. The left leg and the knee in front have the same torques but for what is listed."
    )
    return RowGroup("Fig. 3: joint torques of a support leg", text, tuple(rows))


def reaction_group() -> RowGroup:
    """What the legs do to the body, by the paper's words."""
    hip = -figures.torques_of(figures.RIGHT, KNEE_BEHIND, figures.LEG_KG)[:, 1]
    couples, forces = figures.touch_down_about_diagonal()
    weighty, weightless = (figures.swing_hip_reaction(gravity) for gravity in (GRAVITY_MPS2, 0.0))
    first_half = slice(0, figures.SWING_POINTS // 2 + 1)
    both = round(couples + forces, 9)
    rows = (
        *_signs("support hip's reaction", hip, True),
        PaperRow("touch-down, about the diagonal: hips' couples (N m)", couples, note="Backwards positive."),
        PaperRow("touch-down, about the diagonal: hips' forces (N m)", forces, note="Backwards positive."),
        claim(
            "touch-down, about the diagonal: sign of both (1)",
            0.0,
            float(np.sign(both)),
            note="Claimed: the hips' reaction tips the body backwards.",
            why_not="The ground pushes at the feet, on the diagonal itself, and has no lever about it.",
        ),
        claim(
            "swing hip's reaction, first half: sign (1)",
            0.0,
            float(np.sign(weighty[first_half].mean())),
            above=False,
            note="Claimed: against the support hip's.",
            why_not="The part that speeds the leg up is; its weight, behind the hip, does more the other way.",
        ),
        PaperRow("swing hip's reaction, first half: mean (N m)", float(weighty[first_half].mean())),
        PaperRow("swing hip's reaction, first half: mean without weight (N m)", float(weightless[first_half].mean())),
    )
    text = (
        "A motor turns the body backwards by as much as it turns its leg. A sign of +1 tips the body backwards, onto "
        "its tail. Support: Fig. 3's leg; about the diagonal, left fore and right hind foot with 5 kg each. Swing: "
        "eq. 9 without its y(t), Table 2's stride and period, lifted 20 mm; legs of 0.4 kg whose mass is spread as "
        "ours is."
    )
    return RowGroup("Section 2.1: reaction on the body", text, rows)


def gravity_group() -> RowGroup:
    """Eqs 7 and 8."""
    length, width, off = figures.LENGTH_M, figures.WIDTH_M, figures.off_centre()
    moments = {
        called: diagonal_moment(figures.WEIGHT_N, off.ahead_m, length, width, pair) for called, pair in PAIRS.items()
    }
    about = next(iter(moments.values()))
    printed_y = off.moment_nm * 2 * figures.ROBOT.hip_y_m / (2 * figures.ROBOT.lengths_m[0] + length)
    why_x = "M g d is the moment about a line across the body, before it is taken along the diagonal."
    why_y = "x and y are interchanged, and the diagonal's length is missing."
    rows = (
        PaperRow("m, thigh and shank (kg)", off.leg_mass_kg),
        PaperRow("d, their centre behind the hip (mm)", 1e3 * off.behind_m),
        PaperRow("centre of mass ahead of the middle (mm)", 1e3 * off.ahead_m),
        PaperRow("D, from support foot to support foot (m)", diagonal_m(length, width)),
        PaperRow("M g d, M = 4 m (N m)", off.moment_nm),
        PaperRow("about the diagonal, size (N m)", float(np.linalg.norm(about)), note="M g d (L_y + 2 L1) / D."),
        PaperRow("about x, eq. 8 as printed (N m)", off.moment_nm, note=f"Erratum: {why_x}"),
        PaperRow("about x, size (N m)", abs(float(about[0]))),
        PaperRow("about y, eq. 8 as printed (N m)", printed_y, note=f"Erratum: {why_y}"),
        PaperRow("about y, size (N m)", abs(float(about[1]))),
        *(PaperRow(f"{called}: about x (N m)", float(moment[0])) for called, moment in moments.items()),
        *(PaperRow(f"{called}: about y (N m)", float(moment[1])) for called, moment in moments.items()),
    )
    text = (
        "The paper prints eq. 8 and no number. The numbers are section 4's robot of 10 kg with legs of 0.4 kg, "
        "standing; hips (L_x 0.36, L_y 0.12 m) and how a leg's mass is spread are ours, for the paper prints neither. "
        "Positive about y is onto the nose. The part about x changes its sign with the pair of support feet; the "
        "paper says so of the part about y."
    )
    return RowGroup("Eqs 7 and 8: gravity about the support diagonal", text, rows)


def stance_gravity_group() -> RowGroup:
    """What eq. 7 leaves out: the body moves over its feet."""
    rows = (
        claim(
            "way of a stance with the centre of mass behind the diagonal (1)",
            1.0 - 1e-9,
            figures.behind_share(),
            note="Claimed: always at a distance, to the back.",
            why_not="The body moves 40 mm over its feet, past the diagonal; eq. 7 takes it as standing in the middle.",
        ),
        PaperRow(
            "gravity at touch-down, about the diagonal (N m)",
            _tipping(0),
            note="Backwards positive; feet 20 mm ahead of the hips.",
        ),
        PaperRow(
            "gravity at lift-off, about the diagonal (N m)",
            _tipping(-1),
            note="Backwards positive; feet 20 mm behind the hips.",
        ),
    )
    text = (
        "The same robot on its way over two support feet, from 20 mm behind them to 20 mm ahead, at a constant height: "
        "section 4's stride of 40 mm. That legs weigh elsewhere when they swing is left out, as in the paper."
    )
    return RowGroup("Gravity about the support diagonal over a stance", text, rows)


def curve_group() -> RowGroup:
    """Eqs 11 and 12: which k makes which curve."""
    scale = {peak: figures.scale_for(peak / 1e3) for peak in PEAKS_MM}
    # Eq. 12 as printed, 4 M t^2 / (k J1) - 8 M t / (k J1), with k of 10 mm: M / (k J1) = 64 A / T^2.
    share, period = 64 * 10.0 / figures.WALK_PERIOD_S**2, figures.WALK_PERIOD_S
    printed = [share * (4 * t**2 - 8 * t) for t in (period / 4, period / 2)]
    why_not = "The term in t^2 is printed 16 times too large, and y vanishes at T / 2 only for T = 4 s."
    rows = (
        PaperRow("J1, a leg about its abduction axis (kg m^2)", figures.swing_inertia_kgm2()),
        *(PaperRow(f"k for a peak of {peak} mm (1/m)", value) for peak, value in scale.items()),
        PaperRow("k for 10 mm: y at T / 4, eq. 12 as printed (mm)", printed[0], note=f"Erratum: {why_not}"),
        PaperRow("k for 10 mm: y at T / 4 (mm)", 1e3 * figures.curve_peak_m(scale[10])),
        PaperRow("k for 10 mm: y at T / 2, eq. 12 as printed (mm)", printed[1], note=f"Erratum: {why_not}"),
        PaperRow("k for 10 mm: y at T / 2 (mm)", 0.0),
    )
    text = (
        "y(t) = M t (t - T / 2) / (4 k J1) on [0, T / 2), with M the part about x, which abduction can take up; its "
        "peak is A = M T^2 / (64 k J1) at T / 4. T is 1 s, M positive. The paper prints no k, and so no "
        "number: eq. 12 as printed has the k of 10 mm."
    )
    return RowGroup("Eqs 11 and 12: how large the curve is", text, rows)


def _tipping(instant: int) -> float:
    moment = figures.gravity_over_stance(LEFT_FORE_RIGHT_HIND)[1][instant]
    return float(np.linalg.norm(moment) * -np.sign(moment[1]))


def _signs(called: str, over_stance: Float, is_positive: bool) -> tuple[PaperRow, PaperRow]:
    """What is said of a torque's signs: this one at touch-down, the other at lift-off."""
    return (
        _sign(f"{called}: sign at touch-down (1)", over_stance[0], is_positive),
        _sign(f"{called}: sign at lift-off (1)", over_stance[-1], not is_positive),
    )


def _sign(quantity: str, torque_nm: float, is_positive: bool) -> PaperRow:
    note = f"Claimed: {'positive' if is_positive else 'negative'}."
    return claim(quantity, 0.0, float(np.sign(torque_nm)), note=note, above=is_positive)


def _extremes(called: str, over_stance: Float) -> tuple[PaperRow, PaperRow]:
    return (
        PaperRow(f"{called}, least (N m)", float(over_stance.min())),
        PaperRow(f"{called}, largest (N m)", float(over_stance.max())),
    )


ERRATA = (
    (
        "Eq. 2's last term should be L3 c3 s2. So mended it is a chain with L1 in row 0 of Table 1, which has it in "
        "row 1: there P_x = c1 (L2 c2 + L3 c23) + L1 s1, P_y = s1 (L2 c2 + L3 c23) - L1 c1, P_z = L2 s2 + L3 s23, the "
        "right leg."
    ),
    "Eq. 3 gives an abduction of -38.6° for the foot of eq. 5, which stands straight under its leg's plane: 0°.",
    "Eq. 4's entry (2, 3) should be -L3 s1 s23. It is the left leg's Jacobian, in another frame than eq. 2.",
    "Fig. 3's tau 1 of 0 contradicts eqs 5 and 6, and f_z = m g takes one leg's mass for the body's weight.",
    (
        "Eq. 8 interchanges x and y and leaves out the diagonal's length D, the root of L_x^2 + (L_y + 2 L1)^2. With "
        "eq. 7's d, M = 4 m. The part about x alternates with the support pair, not M_y."
    ),
    (
        "Eq. 11: abduction acts about x, so its M must be the part about x, M g d L_x (L_y + 2 L1) / D^2. Eq. 12 is "
        "not its solution, which is M t (t - T / 2) / (4 k J1); T / 2 presumes that a foot is half of the time in the "
        "air."
    ),
)


def make_table(_fast: bool, _seed: int) -> PaperTable:
    """The table. Nothing is drawn at random and nothing takes time: it is the same for every seed, and never fast."""
    return PaperTable(
        name="foot-torque",
        title="Torques of a trotting robot [Foot, Fig. 3, eqs 7 to 12]",
        caption="From the joint torques of a support leg, their reaction on the body, and gravity about the support "
        "diagonal the paper derives a foot that swings sideways. Here its formulas are worked out, corrected, with its "
        "numbers. It prints Fig. 3 as curves, and otherwise words: a sign of +1 or -1 stands for what it says.",
        sizes="Nothing is drawn at random: one value each, the same for every seed, and with --fast.",
        seed=0,
        fast=False,
        groups=(torque_group(), reaction_group(), gravity_group(), stance_gravity_group(), curve_group()),
        pictures=_pictures(),
        errata=ERRATA,
    )


def _pictures() -> tuple[TablePicture, ...]:
    return (
        drawn(
            "torques",
            "Torques of abduction, hip and knee over a stance, with one leg's mass on the foot and with half a body's.",
            "As Fig. 3, time to the right: above with one leg's mass, as the paper takes it, below with what a support "
            "leg carries.",
            torque_panels(),
        ),
        drawn(
            "tipping",
            "Gravity's moment about the support diagonal over a stance of 40 mm, for both pairs of support feet.",
            "Positive about y, and about the diagonal, is onto the nose. The part about x changes its sign with the "
            "pair. Eq. 8 is the value at 0 mm, for a body that stands still.",
            tipping_panels(),
        ),
    )
