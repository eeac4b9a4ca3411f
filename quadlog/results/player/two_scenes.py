"""Two runs as one scene on a common clock: what both have alike once, all else by letter and in the run's colours."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np

from quadlog.results.player.moments import Moment
from quadlog.results.player.scene import DrawnTrack, Paths, Scene, Windows

RUN_COLORS = {"A": ("robot", "fix"), "B": ("target", "note")}
"""Of a run: of its last track, which is the simulated robot where there is one, its plan and the map; of the rest."""
OF_BOTH, TARGET_OF_BOTH, _POINTS_OF_BOTH = "text", "soft", "resim"
_BOTH = "A and B"


def two_scenes(a: Scene | None, b: Scene | None) -> Scene | None:
    """The scene of both runs, None where nothing moves in either. Labels begin with A, B, or both."""
    scenes = {letter: scene for letter, scene in (("A", a), ("B", b)) if scene is not None}
    if not scenes:
        return None

    def merged(name: str, of_run: Callable[[Any, str], Any], of_both: Callable[[Any], Any]) -> list[Any]:
        of_a, of_b = ([] if scene is None else getattr(scene, name) for scene in (a, b))
        return list(_merged(of_a, of_b, of_run, of_both))

    def labelled(each: DrawnTrack | Paths, letter: str) -> DrawnTrack | Paths:
        walker = each.key if isinstance(each, DrawnTrack) else each.walker
        is_main = walker == scenes[letter].tracks[-1].key
        return replace(each, label=f"{letter}: {each.label}", color=RUN_COLORS[letter][not is_main], run=letter)

    bodies = [scene.body_m for scene in scenes.values() if scene.body_m is not None]
    thinned = {letter: scenes[letter].thinned if letter in scenes else [] for letter in RUN_COLORS}
    return Scene(
        from_s=min(scene.from_s for scene in scenes.values()),
        until_s=max(scene.until_s for scene in scenes.values()),
        tracks=merged("tracks", labelled, _shared),
        paths=merged("paths", labelled, _shared),
        windows=merged("windows", lambda each, letter: replace(each, color=RUN_COLORS[letter][0]), _as_it_is),
        clouds=merged(
            "clouds",
            lambda each, letter: replace(each, color=RUN_COLORS[letter][1]),
            lambda each: replace(each, color=_POINTS_OF_BOTH),
        ),
        contacts=merged("contacts", lambda each, letter: replace(each, run=letter), _as_it_is),
        body_m=bodies[0] if bodies else None,
        thinned=[f"{who}: {what}" for what, who in _letters(thinned["A"], thinned["B"])],
    )


def two_moments(a: Sequence[Moment], b: Sequence[Moment]) -> list[Moment]:
    """The moments of both runs, named by letter; contacts of both first, then the rest in their order."""
    named = [replace(each, what=f"{who}: {each.what}") for each, who in _letters(a, b)]
    kinds = list(dict.fromkeys(each.kind for each in named))
    return sorted(named, key=lambda each: kinds.index(each.kind))


def _letters(a: Sequence[Any], b: Sequence[Any]) -> Iterator[tuple[Any, str]]:
    """Each item that A or B has, and which of them: A, B, or both."""
    for each in a:
        yield each, _BOTH if each in b else "A"
    yield from ((each, "B") for each in b if each not in a)


def _merged(
    a: Sequence[Any], b: Sequence[Any], of_run: Callable[[Any, str], Any], of_both: Callable[[Any], Any]
) -> Iterator[Any]:
    """What both have alike first, so that what differs is drawn over it."""
    only_a, only_b = [], list(b)
    for one in a:
        place = next((k for k, other in enumerate(only_b) if _are_equal(one, other)), None)
        if place is None:
            only_a.append(one)
        else:
            del only_b[place]
            yield of_both(one)
    yield from (of_run(each, "A") for each in only_a)
    yield from (of_run(each, "B") for each in only_b)


def _shared(each: DrawnTrack | Paths) -> DrawnTrack | Paths:
    is_target = isinstance(each, DrawnTrack) and each.key == "target"
    return replace(each, label=f"{_BOTH}: {each.label}", color=TARGET_OF_BOTH if is_target else OF_BOTH)


def _as_it_is(each: Any) -> Any:
    return each


def _are_equal(a: Any, b: Any) -> bool:
    """Whether two dataclasses of one kind hold the same; maps are compared cell by cell."""
    for each in fields(a):
        one, other = getattr(a, each.name), getattr(b, each.name)
        if isinstance(one, np.ndarray):
            same = np.array_equal(one, other, equal_nan=one.dtype.kind == "f")
        elif each.name == "maps":
            continue
        else:
            same = one == other
        if not same:
            return False
    return not isinstance(a, Windows) or _have_equal_cells(a, b)


def _have_equal_cells(a: Windows, b: Windows) -> bool:
    if a.maps.cell_m != b.maps.cell_m or a.maps.shape != b.maps.shape:
        return False
    rows = zip(a.index.tolist(), b.index.tolist(), strict=True)
    return all(np.array_equal(a.maps.occupied(one), b.maps.occupied(other)) for one, other in rows)
