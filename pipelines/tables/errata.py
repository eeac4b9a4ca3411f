"""All errata of the four papers in one place: for the tables' page and, by `python -m`, for docs/errata.md."""

from __future__ import annotations

from quadlog.pipelines.tables.errata_of_following import FOLLOWING
from quadlog.pipelines.tables.errata_of_foot import FOOT
from quadlog.pipelines.tables.errata_of_planning import PLANNING
from quadlog.pipelines.tables.errata_of_tracking import TRACKING
from quadlog.results.paper_errata import errata_text
from quadlog.results.paper_readme import Appendix

ERRATA = {"[Following]": FOLLOWING, "[Planning]": PLANNING, "[Tracking]": TRACKING, "[Foot]": FOOT}
"""By paper, keyed as in docs/references.md, in the order of the papers' own numbers."""
TITLE = "Errata of the four papers"
INTRODUCTION = (
    "What is wrong, or left open, in print, and the right form. quadlog takes the right one; where comparing is\n"
    "instructive, `--preset paper` runs the printed one. What an erratum does to a number stands with the table that\n"
    "measures it.\n"
)


def errata_appendix() -> Appendix:
    """The list as it stands at the end of the tables' page."""
    return Appendix(TITLE, f"{INTRODUCTION}\n{errata_text(ERRATA, 3)}")


def errata_document() -> str:
    """docs/errata.md."""
    return f"# {TITLE}\n\n{INTRODUCTION}\n{errata_text(ERRATA, 2)}"
