"""tracking-5: three controllers on the S-curve [Tracking, Table 5]."""

from __future__ import annotations

from quadlog.pipelines.tables.claims import Claim, Group, Table, order
from quadlog.pipelines.tables.judge import SIZE, not_comparable
from quadlog.pipelines.tables.study import Study, grid, held_out_seeds
from quadlog.pipelines.tables.tracking import CONDITIONS, ERRORS, FIGURES, GROUNDS, fall_row, track

NAMES = ("FpMW", "FpM", "pMW")
ETA, SIGMA, TIME = (0.2801, 0.2933, 0.5133), (0.1957, 0.1981, 0.3822), (64.0, 68.0, 75.0)
PRINTED = {"eta_m": ETA, "sigma_m": SIGMA, "eta_time_m": ETA, "sigma_time_m": SIGMA, "completion_time_s": TIME}
"""Table 5, which does not say what its errors are: either of ours stands beside them."""
CLAIMS = {"eta_m": "η", "sigma_m": "σ", "eta_time_m": "η", "sigma_time_m": "σ", "completion_time_s": "completion time"}
ELSEWHERE = "The paper walked outdoors, one walk each; its course and pose source are not printed."
PAUSES = "The lengths of the paper's course and its pauses are not printed; ours is 30.8 m at 0.5 m/s."
SHARES = (0.3, 1.0)
"""Of mpc.turning_share, 0.6 by default."""


def number_rows(condition: str) -> list[Claim]:
    """Table 5 as printed beside ours."""
    rows: list[Claim] = []
    for at, name in enumerate(NAMES):
        which, where = f"{condition}, {name}", _where(condition, name)
        for column, printed in PRINTED.items():
            judge = not_comparable(printed[at], PAUSES if column == "completion_time_s" else ELSEWHERE)
            quantity = f"{which}: {FIGURES[column]}"
            rows.append(Claim(quantity, column, where, judge, SIZE, of=f"{CLAIMS[column]} of {name}"))
        rows.append(fall_row(which, where))
    return rows


def _where(condition: str, steering: str) -> dict[str, object]:
    return {"condition": condition, "steering": steering, "turning_share": None}


def order_rows(condition: str) -> list[Claim]:
    """FpMW < FpM < pMW, as printed."""
    rows: list[Claim] = []
    pairs = [(column, name, "FpMW") for column in PRINTED for name in NAMES[1:]] + [("eta_m", "pMW", "FpM")]
    for column, more, less in pairs:
        printed = PRINTED[column][NAMES.index(more)] / PRINTED[column][NAMES.index(less)]
        quantity = f"{condition}: {FIGURES[column].rpartition(' (')[0]}, {more} / {less} (1)"
        of = f"order in {CLAIMS[column]}: {more} after {less}"
        where = {"condition": condition, "turning_share": None}
        rows.append(order(quantity, column, where, {"steering": more}, {"steering": less}, printed, of))
    return rows


def share_rows(name: str, share: float) -> list[Claim]:
    """What a constant of ours decides."""
    which, where = f"{name}, turning share {share:g}", {"condition": "ideal", "steering": name, "turning_share": share}
    return [Claim(f"{which}: {FIGURES['eta_m']}", "eta_m", where, statistic=SIZE), fall_row(which, where)]


def table(fast: bool, seed: int) -> Table:
    """Fast walks less often, and with another constant once."""
    seeds = held_out_seeds(2 if fast else 10, seed)
    course = {"course": ["s-curve"], "terrain": ["course"]}
    points = grid(**course, steering=NAMES, condition=CONDITIONS, seed=seeds)
    names, shares, few = (NAMES[1:2], SHARES[1:], 1) if fast else (NAMES[:2], SHARES, 5)
    points += grid(**course, steering=names, condition=["ideal"], seed=seeds[:few], turning_share=shares)
    return Table(
        title="Three controllers on an S-curve [Tracking, Table 5]",
        caption="A quadruped follows an S-curve, up 15° and down 20°, by fuzzy pure pursuit with MPC and whole-body "
        "control (FpMW), without whole-body control (FpM), and with a fixed look-ahead instead of the fuzzy one (pMW, "
        "l = 2 m). The paper did it outdoors with a robot of its own, once each. Here it is simulated, on a course of "
        "the same slopes and roughness whose lengths are ours (30.8 m at 0.5 m/s).",
        sizes=f"{len(seeds)} walks of each controller, ideal and disturbed, seed {seed}: walks drawn from seeds "
        f"{seeds[0]} to {seeds[-1]}.",
        study=Study(track, points),
        groups=[
            *(
                Group(f"Table 5, {condition}", f"{GROUNDS[condition]} {ERRORS}", number_rows(condition))
                for condition in CONDITIONS
            ),
            Group(
                "The order of the three",
                "Table 5's order is FpMW, FpM, pMW in all of its rows. It is judged, and not by how much: our interval "
                "has to lie above 1, by a tenth of the printed difference at least. Walks are paired by seed. "
                "Geometric means; intervals: Student, of the logarithms.",
                [row for condition in CONDITIONS for row in order_rows(condition)],
            ),
            Group(
                "What a constant of ours decides",
                "Turning share (mpc.turning_share, 0.6 by default): the share of the standing robot's inertia that the "
                "MPC takes to turn with the trunk, which is not printed. Intervals: Student; shares after Wilson.",
                [row for name in NAMES[:2] for share in SHARES for row in share_rows(name, share)],
            ),
        ],
    )
