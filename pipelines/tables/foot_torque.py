"""The table foot-torque: [Foot]'s torque analysis, Fig. 3 and eqs 7, 8, 11 and 12, worked out again."""

from __future__ import annotations

from quadlog.pipelines.tables.foot_torque_pictures import draw_tipping, draw_torques
from quadlog.pipelines.tables.foot_torque_rows import (
    curve_group,
    gravity_group,
    reaction_group,
    stance_gravity_group,
    torque_group,
)
from quadlog.results.paper_rows import PaperTable, Picture
from quadlog.results.plots.style import render_png

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


def _pictures() -> tuple[Picture, ...]:
    torques, tipping = render_png(draw_torques), render_png(draw_tipping)
    assert torques is not None
    assert tipping is not None
    return (
        Picture(
            "torques",
            "Torques of abduction, hip and knee over a stance, with one leg's mass on the foot and with half a body's.",
            "As Fig. 3, time to the right: left with one leg's mass, as the paper takes it, right with what a support "
            "leg carries. Dashed: the printed τ1.",
            torques,
        ),
        Picture(
            "tipping",
            "Gravity's moment about the support diagonal over a stance of 40 mm, for both pairs of support feet.",
            "Positive about y, and about the diagonal, is onto the nose. The part about x changes its sign with the "
            "pair. The dot is eq. 8, for a body that stands still; over a stance the body passes the diagonal.",
            tipping,
        ),
    )
