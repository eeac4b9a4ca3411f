"""What a replay saves of how good UWB was: links.parquet, dilution.npz and, with a reference, uwb_errors.parquet."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from quadlog.pipelines.stages.walk import Walk
from quadlog.pipelines.tag_truth import levers_on_robot
from quadlog.pipelines.uwb_quality import TagErrors, dilution_of, errors_of_tags
from quadlog.positioning.link_quality import link_quality, weak_first_path_share
from quadlog.results.dilution import DilutionGrid, write_dilution
from quadlog.results.schemas import TABLES
from quadlog.results.tables import TableWriter

if TYPE_CHECKING:
    from quadlog.pipelines.stages.uwb import UwbPositions

DILUTION_ROWS, DILUTION_COLUMNS = 240, 240


def write_uwb_tables(walk: Walk, uwb: UwbPositions) -> None:
    """The links of every tag, the geometry's dilution, and the errors of the tags that sit on the robot."""
    _write_links(walk, uwb)
    robot_tag = None if uwb.robot is None else uwb.robot.tag
    dilution = dilution_of(uwb.located, robot_tag, walk.config, DILUTION_ROWS, DILUTION_COLUMNS)
    if dilution is not None:
        grid = DilutionGrid(dilution.origin_m, dilution.cell_m, dilution.tag_height_m, dilution.hdop)
        write_dilution(walk.run.path, grid)
    errors = errors_of_tags(uwb.located, levers_on_robot(walk.config, robot_tag), walk.streams.reference)
    if errors:
        _write_errors(walk.run.path, errors)


def _write_links(walk: Walk, uwb: UwbPositions) -> None:
    """A row for every tag and configured anchor, also a silent one."""
    config, streams = walk.config, walk.streams
    assert streams.ranges is not None
    anchor_ids = np.array([anchor.id for anchor in config.uwb.anchors], dtype=np.int64)
    places = {f"{axis}_m": np.array([getattr(each, f"{axis}_m") for each in config.uwb.anchors]) for axis in "xyz"}
    with TableWriter(walk.run.path / "links.parquet", TABLES["links"]) as links:
        for result in uwb.located.tags:
            quality = link_quality(result.ranges, anchor_ids, result.bias, config.uwb.range_std_m)
            columns = {
                "tag": result.tag,
                "anchor": anchor_ids,
                "n": quality.n,
                "residual_rms_m": quality.residual_rms_m,
                "residual_median_m": quality.residual_median_m,
                "bias_m": quality.bias_m,
                "bias_std_m": quality.bias_std_m,
                "bias_applied": quality.bias_applied,
                "why_not": np.array(quality.why_not),
                "nlos_share": quality.nlos_share,
                "weak_first_path_share": weak_first_path_share(
                    streams.ranges, streams.range_gap_db, result.tag, anchor_ids
                ),
            }
            links.append(places | columns)


def _write_errors(run: Path, errors: dict[int, TagErrors]) -> None:
    with TableWriter(run / "uwb_errors.parquet", TABLES["uwb_errors"]) as table:
        for tag, of_tag in errors.items():
            for source, part in (("fixes", of_tag.fixes), ("track", of_tag.track)):
                error_x_m, error_y_m = part.error_m.T
                columns = {"error_x_m": error_x_m, "error_y_m": error_y_m, "bound_m": part.bound_m}
                table.append({"t_ns": part.t_ns, "tag": tag, "source": source} | columns)
