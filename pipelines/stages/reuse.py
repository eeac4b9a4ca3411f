"""Going on where an earlier replay stopped: what of its folder still holds, and the marks of what is done now."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from quadlog.pipelines.stages.handover import Known, hand_over, known_of, note_known
from quadlog.pipelines.stages.unit_keys import unit_keys
from quadlog.pipelines.stages.units import Unit
from quadlog.pipelines.stages.walk import Walk
from quadlog.results.files import files_written
from quadlog.results.stage_marks import MARKS_FILE, StageMark, files_are_whole, mark_files, read_marks, write_marks

if TYPE_CHECKING:
    from quadlog.pipelines.replay import ReplayRequest

Earlier = Mapping[Unit, StageMark]
"""The units that an earlier replay has done, in order, all from the first one on."""


def find_reusable(request: ReplayRequest, identity: str) -> Earlier:
    """What is done of a request: the same key as now, and every file as it was left. identity: the input's."""
    found: dict[Unit, StageMark] = {}
    marks = read_marks(request.run)
    for unit, key in unit_keys(request, identity).items() if marks else ():
        mark = marks.get(unit.name)
        if mark is None or mark.key != key or known_of(mark) is None or not files_are_whole(request.run, mark):
            break
        found[unit] = mark
    return found


def stages_of(earlier: Earlier) -> tuple[str, ...]:
    """The stages that need not be done again."""
    return tuple(stage for unit in earlier for stage in unit.stages)


class MarkedStages:
    """Does each unit of a walk once: what is done already is handed over, the rest is done now and marked."""

    def __init__(self, walk: Walk, request: ReplayRequest, earlier: Earlier) -> None:
        self._walk, self._earlier = walk, earlier
        self._keys = unit_keys(request, walk.input.identity)
        self._marks: list[StageMark] = []
        walk.reused = stages_of(earlier)
        walk.keep = (MARKS_FILE, *(file.name for mark in earlier.values() for file in mark.files)) if earlier else ()

    def do(self, unit: Unit, work: Callable[[Walk], None]) -> None:
        """One unit, those before it being done. Raises what the work raises."""
        walk = self._walk
        if (mark := self._earlier.get(unit)) is not None:
            known = Known.model_validate(mark.known)
            walk.begin_folder()
            hand_over(known, unit, walk)
            self._note(mark)
            return
        with files_written() as written:
            work(walk)
        known = note_known(walk, unit)
        # Not what is there: a mark must miss what another process has removed meanwhile.
        files = mark_files(walk.run.path, [name for name in unit.files if walk.run.path / name in written])
        self._note(StageMark(stage=unit.name, key=self._keys[unit], files=files, known=known.model_dump()))
        write_marks(walk.run.path, self._marks)

    def _note(self, mark: StageMark) -> None:
        self._marks.append(mark)
        self._walk.left |= {MARKS_FILE, *(file.name for file in mark.files)}
