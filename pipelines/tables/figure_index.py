"""Every table and figure of the four papers: which of ours has its quantities, or why none has."""

from __future__ import annotations

from typing import NamedTuple

from quadlog.results.page.blocks import Cell, Column, Section, Table

NOTHING_TO_MEASURE = "shows a robot, a device, a place or a method: nothing to measure"
LOST = "lost but for its text: 3.24 m/s, slopes of 35°, loads of 15.07 kg, by a robot whose legs are not printed"
PARAMETERS = "a parameter: an input of what is measured"


class Shown(NamedTuple):
    """Tables or figures of a paper, "1" or "9-12", and where ours are: tables of TABLES, or none and a reason."""

    kind: str
    numbers: str
    tables: tuple[str, ...]
    remark: str = ""


SHOWN = {
    "[Following]": (
        Shown(
            "Table",
            "1",
            (),
            LOST,
        ),
        Shown("Table", "2", ("following-2",), "its numbers are lost, its claim is judged"),
        Shown("Figs", "1-4", (), NOTHING_TO_MEASURE),
        Shown("Figs", "5-6", (), "the ranging's and the trilateration's principle; see the errata"),
        Shown("Fig.", "7", ("following-lidar",)),
        Shown("Fig.", "8", (), NOTHING_TO_MEASURE),
        Shown("Figs", "9-12", ("following-uwb",), "on ranges of our own, for theirs are not published"),
        Shown("Fig.", "13", (), NOTHING_TO_MEASURE),
        Shown("Figs", "14-15", ("following-2",), "the scenes with static and with moving obstacles"),
        Shown("Fig.", "16", (), NOTHING_TO_MEASURE),
        Shown("Figs", "17-18", ("following-2",), "distance to the person and to obstacles, on ground of our own"),
    ),
    "[Planning]": (
        Shown("Table", "1", ("planning-1",)),
        Shown("Table", "2", ("planning-2",)),
        Shown("Figs", "1-9", (), NOTHING_TO_MEASURE),
        Shown("Figs", "10-12", ("planning-ea",), "whether a passage stays open, and how the charges add up"),
        Shown("Figs", "13-14", (), NOTHING_TO_MEASURE),
        Shown("Fig.", "15", ("planning-2",), "as cells a replan; it prints pictures of single searches"),
        Shown("Figs", "16-17", ("planning-1",)),
        Shown("Fig.", "18", ("planning-2",)),
        Shown("Figs", "19-21", ("planning-ea",)),
    ),
    "[Tracking]": (
        Shown("Tables", "1-4", (), PARAMETERS),
        Shown("Table", "5", ("tracking-5",)),
        Shown("Figs", "1-5", (), NOTHING_TO_MEASURE),
        Shown("Fig.", "6", (), "the surfaces that Tables 1 and 2 make: parameters, too"),
        Shown("Figs", "7-9", (), NOTHING_TO_MEASURE),
        Shown("Figs", "10-24", ("tracking-courses",)),
        Shown("Figs", "25-26", (), NOTHING_TO_MEASURE),
        Shown("Figs", "27-29", ("tracking-5",), "simulated: the robot and its field are not to be had"),
    ),
    "[Foot]": (
        Shown("Tables", "1-2", (), PARAMETERS),
        Shown("Figs", "1-2", (), NOTHING_TO_MEASURE),
        Shown("Fig.", "3", ("foot-torque",)),
        Shown("Fig.", "4", ("foot-torque",), "the moment that it sketches"),
        Shown("Figs", "5-6", ("foot-drift",)),
    ),
}


def figures_section() -> Section:
    """The list as it stands on the tables' page."""
    rows = [
        (paper, f"{shown.kind} {shown.numbers.replace('-', ' to ')}", ", ".join(shown.tables), shown.remark)
        for paper, mine in SHOWN.items()
        for shown in mine
    ]
    columns = [*map(Column, ("paper", "printed as", "here", "remark"))]
    table = Table(columns, [[*map(Cell, row)] for row in rows], "figures", search="Search, as in Fig. 18")
    return Section("Where the papers' figures are", [table])
