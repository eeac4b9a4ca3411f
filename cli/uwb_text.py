"""What `quadlog info` prints of UWB: links, tags, and where the anchors' geometry is good."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

MOST_LINKS = 40  # as many lines of links as a terminal or two hold
CELL = 6  # characters of a number of the map, with the space before it


def reach_lines(links: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Each link with its count and its shortest and longest range, or as many as fit, and how many more there are."""
    for link in links[:MOST_LINKS]:
        ends = f"  {link['topic']}  tag {link['tag']}  anchor {link['anchor']}  {link['n']} ranges"
        known = link["range_min_m"] is not None
        yield ends + (f"  {link['range_min_m']:.2f}..{link['range_max_m']:.2f} m" if known else "  none a number")
    if len(links) > MOST_LINKS:
        yield f"  and {len(links) - MOST_LINKS} more links, all of them in --json"


def link_table(rows: Sequence[dict[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Names of the columns and the cells of `uwb`; an estimate that is not applied says why."""
    columns = ["tag", "anchor", "ranges", "residual m", "median m", "NLOS", "bias m", ""]
    cells = [_link_cells(row) for row in rows]
    if any(row["weak_first_path_share"] is not None for row in rows):
        columns.insert(6, "weak path")
        for row, line in zip(rows, cells, strict=True):
            share = row["weak_first_path_share"]
            line.insert(6, "" if share is None else f"{100 * share:.1f} %")
    return columns, cells


def _link_cells(row: dict[str, Any]) -> list[str]:
    bias = "" if row["bias_m"] is None else f"{row['bias_m']:+.3f} +- {row['bias_std_m']:.3f}"
    return [
        *(str(row[name]) for name in ("tag", "anchor", "n")),
        f"{row['residual_m']:.3f}",
        f"{row['residual_median_m']:+.3f}",
        f"{100 * row['nlos_share']:.1f} %",
        bias,
        "applied" if row["bias_applied"] else f"not applied: {row['why_not']}",
    ]


def tag_lines(row: dict[str, Any]) -> Iterator[str]:
    """How good a tag's fixes are by themselves, and against the reference if there is one."""
    name = f"tag {row['tag']}" + (f" ({row['role']})" if row["role"] else "")
    causes = {"with too few ranges": row["too_few_ranges"], "degenerate": row["degenerate"]}
    without = ", ".join(f"{count} {cause}" for cause, count in causes.items() if count)
    line = f"{name}: {row['fixes']} fixes in {row['epochs']} epochs" + (f" ({without})" if without else "")
    if row["fixes"]:
        axes = f"{row['ellipse_major_median_m']:.3f} x {row['ellipse_minor_median_m']:.3f} m"
        line += f"; median HDOP {row['hdop_median']:.2f}, median 95 % semi-axes {axes}"
    yield line
    for what, error in (("fixes", row["fix_error"]), ("track", row["track_error"])):
        if error is not None:
            yield (
                f"  {what} against {row['reference']}: RMSE {error['rmse_m']:.3f} m, "
                f"bias ({error['bias_x_m']:+.3f}, {error['bias_y_m']:+.3f}) m, "
                f"{100 * error['share_in_ellipse']:.1f} % in their 95 % ellipses"
            )


def dilution_lines(dilution: dict[str, Any]) -> Iterator[str]:
    """HDOP on a coarse map, north up, at the cells' centres."""
    cell_m, rows = dilution["cell_m"], dilution["hdop"]
    yield f"HDOP (std of a fix per std of a range) for a tag at {dilution['tag_height_m']:g} m; '-': no fix"
    labels = [f"{dilution['origin_y_m'] + (index + 0.5) * cell_m:g}" for index in range(len(rows))]
    width = max(len(label) for label in [*labels, "y m"])
    yield "y m".rjust(width)
    for label, row in zip(reversed(labels), reversed(rows), strict=True):
        yield label.rjust(width) + " |" + "".join(_hdop(value).rjust(CELL) for value in row)
    x_labels = [f"{dilution['origin_x_m'] + (index + 0.5) * cell_m:g}" for index in range(len(rows[0]))]
    yield " " * width + " +" + "-" * (CELL) * len(x_labels)
    yield "x m".rjust(width) + "  " + "".join(label.rjust(CELL) for label in x_labels)


def _hdop(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2f}" if value < 10 else ">10"
