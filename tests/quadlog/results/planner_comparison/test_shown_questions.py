"""Which questions of a comparison its page shows: whole episodes or every n-th question, within bounds."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from quadlog.mapping.grid import Window
from quadlog.results.planner_comparison.shown_questions import (
    MAX_DEFLATED_BYTES,
    MAX_MAP_CELLS,
    MAX_PATH_POINTS,
    MAX_QUESTIONS,
    QuestionSample,
    ShownQuestions,
)

WINDOW = Window(0, 0, 0.1, (8, 9))
FREE = np.zeros(WINDOW.shape, dtype=bool)
PATH = np.array([[0, 0], [1, 1], [2, 2], [3, 2], [4, 2]], dtype=np.int32)
ENDS = ((0, 0), (4, 2))


def sampled(questions: list[tuple[int, int]], *, is_static: bool = False, sources: int = 1) -> ShownQuestions:
    sample = QuestionSample(is_static, row_zero_on_top=False, sources=sources)
    for at in questions:
        sample.add(at, WINDOW, (FREE, FREE), ENDS, {"astar": PATH})
    shown = sample.finish()
    assert shown is not None
    return shown


def places(shown: ShownQuestions) -> list[tuple[int, int]]:
    return [(each.episode, each.replan) for each in shown.questions]


def test_whole_episodes_are_shown_while_there_is_room() -> None:
    asked = [(episode, replan) for episode in range(10) for replan in range(200)]
    shown = sampled(asked)
    assert places(shown) == asked[:MAX_QUESTIONS]
    assert shown.stride == 1
    assert places(sampled(asked, sources=4)) == asked[:200]


def test_a_long_walk_is_shown_from_end_to_end() -> None:
    shown = sampled([(0, replan) for replan in range(10 * MAX_QUESTIONS)] + [(1, 0), (1, 1)])
    assert shown.stride == 16
    assert places(shown) == [(0, replan) for replan in range(0, 10 * MAX_QUESTIONS, 16)]


@pytest.mark.parametrize("planners", [("astar",), ("astar", "ia_star", "dijkstra")])
def test_questions_that_stand_alone_are_spread_evenly_whoever_is_asked_first(planners: tuple[str, ...]) -> None:
    sample = QuestionSample(is_static=True, row_zero_on_top=True)
    for name in planners:
        for episode in range(3000):
            sample.add((episode, 0), WINDOW, (FREE, FREE), ENDS, {name: PATH})
    shown = sample.finish()
    assert places(shown) == [(episode, 0) for episode in range(0, 3000, 4)]
    assert all(tuple(each.paths) == planners for each in shown.questions)
    assert len({id(each.map) for each in shown.questions}) == 1
    # Row 0 is the upper one of such maps.
    assert shown.questions[0].start == (0, 7)
    assert shown.questions[0].paths["astar"].tolist() == [[0, 7], [2, 5], [4, 5]]


@pytest.mark.parametrize("what", ["maps", "paths"])
def test_noise_stays_within_bounds(what: str) -> None:
    rng = np.random.default_rng(0)
    window = Window(5, -3, 0.1, (160, 160))
    sample = QuestionSample(is_static=False, row_zero_on_top=False)
    for replan in range(900):
        noise = rng.random(window.shape) < 0.5 if what == "maps" else np.zeros(window.shape, bool)
        path = rng.integers(0, 120, (2 if what == "maps" else 400, 2)).astype(np.int32)
        sample.add((0, replan), window, (noise, noise), ENDS, {"astar": path})
    shown = sample.finish()
    assert shown.stride == 2
    points = sum(len(each.paths["astar"]) for each in shown.questions)
    deflated = len(shown.questions) * 160 * 160 // 8
    assert (deflated if what == "maps" else points) <= (MAX_DEFLATED_BYTES if what == "maps" else MAX_PATH_POINTS)


def test_a_large_map_is_shown_coarser_and_keeps_thin_walls() -> None:
    side = int(MAX_MAP_CELLS**0.5) + 101
    wall = np.zeros((side, side), dtype=bool)
    wall[:, 1001] = True
    sample = QuestionSample(is_static=True, row_zero_on_top=False)
    sample.add((0, 0), Window(0, 0, 1.0, (side, side)), (wall, wall), ENDS, {})
    shown = sample.finish()
    assert shown.step == 2
    rows, columns = shown.shape
    bits = np.frombuffer(shown.questions[0].map.obstacles, np.uint8).reshape(rows, -1)
    cells = np.unpackbits(bits, axis=1, count=columns).astype(bool)
    assert np.flatnonzero(cells.all(axis=0)).tolist() == [500]
    assert cells.sum() == rows


STEPS = [(1, 0), (0, 1), (1, 1), (1, -1), (-1, 0), (0, -1)]


@given(st.lists(st.sampled_from(STEPS), max_size=60))
def test_the_corners_of_a_path_give_all_of_its_cells(steps: list[tuple[int, int]]) -> None:
    path = np.cumsum([(30, 30), *steps], axis=0).astype(np.int32)
    sample = QuestionSample(is_static=False, row_zero_on_top=False)
    sample.add((0, 0), Window(7, -2, 0.1, (8, 9)), (FREE, FREE), ENDS, {"astar": path})
    corners = sample.finish().questions[0].paths["astar"] - (7, -2)
    cells = [corners[:1]]
    for begin, end in itertools.pairwise(corners):
        count = np.abs(end - begin).max()
        cells.append(begin + np.arange(1, count + 1)[:, None] * (end - begin) // max(count, 1))
    assert np.concatenate(cells).tolist() == path.tolist()


def test_nothing_is_shown_of_nothing() -> None:
    assert QuestionSample(is_static=False, row_zero_on_top=False).finish() is None
