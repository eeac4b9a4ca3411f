from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.results.compare.differences import ResultDifference, Tolerance
from quadlog.results.compare.file_diff import compare_files
from quadlog.results.run.maps import (
    MapsWriter,
    load_maps,
    read_cloud_samples,
    read_dilution,
    read_ground,
    write_cloud_samples,
    write_dilution,
    write_ground,
)

EXACT = Tolerance()


def write_maps(run: Path, maps: list[Any], cell_m: float = 0.1) -> None:
    with MapsWriter(run / "maps.npz", cell_m, maps[0][2].shape) as writer:
        for each in maps:
            writer.append(*each)


def compare_maps(a: Path, b: Path, tolerance: Tolerance = EXACT) -> ResultDifference:
    return compare_files("maps.npz", a, b, tolerance)


def test_the_first_map_that_differs_and_its_cells(tiny_run: Path, other: Path) -> None:
    maps = [list(each) for each in load_maps(tiny_run)]
    rng = np.random.default_rng(0)
    for i, count in ((11, 5), (30, 17)):
        cells = rng.choice(maps[i][2].size, count, replace=False)
        maps[i][2].flat[cells] ^= True
    write_maps(other, maps)
    (column,) = compare_maps(tiny_run, other).columns
    before = [int(each.occupied.sum()) for each in load_maps(tiny_run)]
    assert (column.column, column.rows, column.apart, column.largest) == ("cells", 2, 5, 17)
    assert (column.first.t_ns, column.a, column.b) == (maps[11][0], before[11], int(maps[11][2].sum()))


def test_a_moved_window_is_told_by_its_origin_not_by_cells(tiny_run: Path, other: Path) -> None:
    maps = [list(each) for each in load_maps(tiny_run)]
    maps[4][1] = maps[4][1] + [0.0, 0.1]
    maps[4][2] = ~maps[4][2]
    write_maps(other, maps)
    (column,) = compare_maps(tiny_run, other).columns
    assert (column.column, column.rows, column.first.t_ns) == ("origin_y_m", 1, maps[4][0])
    assert column.apart == pytest.approx(0.1)


def test_a_lost_map_shifts_no_other(tiny_run: Path, other: Path) -> None:
    maps = [list(each) for each in load_maps(tiny_run)]
    write_maps(other, maps[:7] + maps[8:])
    found = compare_maps(tiny_run, other)
    assert found.columns == ()
    assert found.only_in_a is not None
    assert (found.only_in_a.rows, found.only_in_a.first.t_ns, found.only_in_b) == (1, maps[7][0], None)


def test_maps_of_another_size_are_not_compared_cell_by_cell(tiny_run: Path, other: Path) -> None:
    write_maps(other, [(each.t_ns, each.origin_m, each.occupied[:, :-1]) for each in load_maps(tiny_run)], 0.2)
    assert [each.key for each in compare_maps(tiny_run, other).values] == ["cell_m", "columns"]


def test_ground_and_dilution_cell_by_cell(tiny_run: Path, other: Path) -> None:
    ground, grid = read_ground(tiny_run), read_dilution(tiny_run)
    row, column = (int(each[0]) for each in np.nonzero(np.isfinite(ground.height_m)))
    ground.height_m[row, column] += 0.5
    write_ground(other, ground)
    (found,) = compare_files("ground.npz", tiny_run, other, EXACT).columns
    assert (found.column, found.first.keys, found.rows) == ("height_m", (("row", row), ("column", column)), 1)
    assert found.apart == pytest.approx(0.5)
    grid.hdop[3, 4] += 0.25
    write_dilution(other, grid)
    (found,) = compare_files("dilution.npz", tiny_run, other, EXACT).columns
    assert (found.column, found.first.keys) == ("hdop", (("row", 3), ("column", 4)))
    write_dilution(other, replace(grid, tag_height_m=1.0))
    assert [each.key for each in compare_files("dilution.npz", tiny_run, other, EXACT).values] == ["tag_height_m"]


def test_sampled_points_by_scan_and_class(tiny_run: Path, other: Path) -> None:
    samples, classes = read_cloud_samples(tiny_run)
    samples[1].label[7] = (samples[1].label[7] + 1) % 5
    write_cloud_samples(other, samples, classes)
    (found,) = compare_files("cloud_samples.npz", tiny_run, other, EXACT).columns
    assert (found.column, found.rows, found.first.keys) == ("label", 1, (("point", 7),))
    assert {found.a, found.b} <= set(classes)


def test_a_trajectory_pose_by_pose(tiny_run: Path, other: Path) -> None:
    lines = (other / "trajectory.tum").read_text().splitlines()
    fields = lines[9].split()
    lines[9] = " ".join([fields[0], repr(float(fields[1]) + 0.125), *fields[2:]])
    (other / "trajectory.tum").write_text("\n".join(lines))
    (found,) = compare_files("trajectory.tum", tiny_run, other, EXACT).columns
    assert (found.column, found.rows, found.a) == ("x_m", 1, float(fields[1]))
    assert found.apart == pytest.approx(0.125)
    assert compare_files("trajectory.tum", tiny_run, other, Tolerance(0.126)).same


def test_the_map_for_ros(tiny_run: Path, other: Path) -> None:
    content = bytearray((other / "map.pgm").read_bytes())
    content[-5:] = bytes(each ^ 255 for each in content[-5:])
    (other / "map.pgm").write_bytes(content)
    (value,) = compare_files("map.pgm", tiny_run, other, EXACT).values
    assert (value.key, value.apart) == ("bytes", 5)
    text = (other / "map.yaml").read_text()
    (other / "map.yaml").write_text(text.replace("resolution: 0.1", "resolution: 0.2").replace("-2.5", "-2.4"))
    found = compare_files("map.yaml", tiny_run, other, EXACT)
    assert [(each.key, each.a, each.b) for each in found.values] == [
        ("origin.0", -2.5, -2.4),
        ("origin.1", -2.5, -2.4),
        ("resolution", 0.1, 0.2),
    ]
