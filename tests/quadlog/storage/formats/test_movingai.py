from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.errors import QuadlogError, TooLarge, UnreadableFile
from quadlog.storage.formats.movingai import read_movingai_map, read_movingai_scen

MAP = b"type octile\nheight 3\nwidth 4\nmap\n.GS.\n@OTW\n..T.\n"
# The two queries that the benchmark's own description of the format shows.
SCEN = (
    b"version 1\n0\tmaps/dao/arena.map\t49\t49\t1\t11\t1\t12\t1\n0\tmaps/dao/arena.map\t49\t49\t1\t13\t4\t12\t3.41421\n"
)

terrains = st.integers(1, 12).flatmap(
    lambda cols: st.lists(st.text(".GS@OTW", min_size=cols, max_size=cols), min_size=1, max_size=12)
)


def cell_by_cell(content: bytes) -> list[list[bool]]:
    """What the file says, read as simply as can be."""
    lines = [line.removesuffix(b"\r") for line in content.split(b"\n")]
    header = dict(line.split() for line in lines[:3])
    rows = [
        [bytes([each]) not in {b".", b"G", b"S"} for each in line] for line in lines[4 : 4 + int(header[b"height"])]
    ]
    assert {len(row) for row in rows} == {int(header[b"width"])}
    return rows


def field_by_field(content: bytes) -> list[tuple[object, ...]]:
    queries: list[tuple[object, ...]] = []
    for line in re.split("\r\n|\r|\n", content.decode())[1:]:
        if line.strip():
            text = line.removesuffix("\r").strip(" \t")
            bucket, name, *rest, cost = text.split("\t") if text.count("\t") == 8 else text.split()
            int(bucket)
            assert name.strip() in ("maps/dao/arena.map", content.split()[3].decode())
            *size, sx, sy, gx, gy = map(int, rest)
            assert size == [49, 49]
            queries.append(((sx, sy), (gx, gy), float(cost)))
    return queries


def damaged(content: bytes) -> Iterator[bytes]:
    """Anywhere: cut, a byte left out or doubled, and one of what may mean something instead of it."""
    odd = cycle(b"0129.-+_,e@GtW \t\n\r\v\x00\x1b\x1c\x7f\x85\xa0\xc3\xff")
    for at in range(len(content)):
        yield content[:at]
        for instead in (b"", content[at : at + 1] * 2, bytes([next(odd)])):
            yield content[:at] + instead + content[at + 1 :]


def names_a_line(error: QuadlogError, content: bytes) -> bool:
    if isinstance(error, UnreadableFile):
        line = re.search(r", line ([1-9]\d*): ", str(error))
        assert line is not None, content
        assert int(line[1]) <= content.count(b"\n") + 2, content  # what is missing comes after
    else:
        assert isinstance(error, TooLarge), content
        assert ", line " in str(error), content
    return True


@given(rows=terrains, header=st.permutations([0, 1, 2]), end=st.sampled_from(["\n", "\r\n"]), after=st.integers(0, 3))
def test_any_map_comes_back(tmp_path_factory, rows, header, end, after):
    path = tmp_path_factory.mktemp("maps") / "a.map"
    head = ["type octile", f"height {len(rows)}", f"width {len(rows[0])}"]
    path.write_bytes((end.join([*(head[each] for each in header), "map", *rows]) + end * after).encode())
    blocked = read_movingai_map(path)
    assert blocked.dtype == np.bool_
    assert blocked.tolist() == [[each in "@OTW" for each in row] for row in rows]


def of_map(path: Path) -> object:
    return read_movingai_map(path).tolist()


def of_scen(path: Path) -> object:
    return read_movingai_scen(path, (49, 49))


# Of the scenario, the first query between tabs, the second one between blanks.
MIXED = SCEN.replace(b"\t", b" ").replace(b" ", b"\t", 9).replace(b"version\t", b"version ")


@pytest.mark.parametrize(
    ("content", "read", "expected"), [(MAP, of_map, cell_by_cell), (MIXED, of_scen, field_by_field)]
)
def test_a_damaged_file_is_read_as_it_stands_or_refused(tmp_path, content, read, expected):
    path, refused = tmp_path / "a", 0
    for each in damaged(content):
        path.write_bytes(each)
        try:
            found = read(path)
        except QuadlogError as error:
            refused += names_a_line(error, each)
        else:
            assert found == expected(each), each
    assert refused > 30


names = st.text(st.characters(codec="utf-8", categories=("L", "N", "P")), min_size=1, max_size=20)
cells = st.tuples(st.integers(0, 48), st.integers(0, 30))
rows_of_scen = st.tuples(st.integers(0, 10**6), cells, cells, st.floats(0, 1e6))


@given(
    queries=st.lists(rows_of_scen, min_size=1, max_size=8),
    name=names,
    tabs=st.booleans(),
    version=st.sampled_from(["version 1", "version 1.0", "version\t1.0 "]),
    end=st.sampled_from(["\n", "\r\n"]),
    after=st.integers(0, 3),
)
def test_any_scenario_comes_back(tmp_path_factory, queries, name, tabs, version, end, after):
    path = tmp_path_factory.mktemp("scens") / "a.scen"
    between, blank = ("\t", " ") if tabs else (" ", "_")
    lines = [
        between.join(map(str, (bucket, f"a{blank}{name}", 49, 31, *start, *goal, repr(cost))))
        for bucket, start, goal, cost in queries
    ]
    path.write_bytes((end.join([version, *lines]) + end * after).encode())
    assert read_movingai_scen(path, (31, 49)) == [query[1:] for query in queries]


def test_a_scenario_must_be_for_the_map(tmp_path: Path) -> None:
    path = tmp_path / "a.scen"
    path.write_bytes(SCEN.replace(b"49\t49", b"49\t30"))
    assert len(read_movingai_scen(path, (30, 49))) == 2
    with pytest.raises(
        UnreadableFile, match=r"a\.scen, line 2: is for a map of 49 x 30 cells, and the map has 30 x 49"
    ):
        read_movingai_scen(path, (49, 30))
    path.write_bytes(SCEN.replace(b"arena.map\t49\t49\t1\t13", b"arena2.map\t49\t49\t1\t13"))
    with pytest.raises(UnreadableFile, match=r"line 3: is for another map than maps/dao/arena\.map"):
        read_movingai_scen(path, (49, 49))
