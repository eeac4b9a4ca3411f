"""Which stages the runs of a sweep share, and how a run takes them over from the one that has done them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from quadlog.config.schema import Config
from quadlog.errors import CannotWrite
from quadlog.pipelines.stages.stage import Stage
from quadlog.results.places import claim, place_of_new
from quadlog.results.record import read_record
from quadlog.results.run import Run
from quadlog.results.stage_marks import read_marks, write_marks
from quadlog.storage.atomic_write import part_prefix


@dataclass(frozen=True, slots=True)
class Shared:
    """Stages that several runs have in common, and that are done once.

    leader: the run that does them; members: all runs with the same results up to `depth` stages, leader included.
    """

    depth: int
    leader: int
    members: tuple[int, ...]


def shared_stages(keys: Sequence[Mapping[Stage, str]]) -> list[Shared]:
    """Where the runs part, from the stages' keys of each run; the fewest stages first.

    After each of these stages at least two runs go on differently, or all stages are done.
    """
    chains = [tuple(each.values()) for each in keys]
    found = []
    for depth in range(1, len(chains[0]) + 1):
        groups: dict[str, list[int]] = {}
        for number, chain in enumerate(chains):
            groups.setdefault(chain[depth - 1], []).append(number)
        for members in groups.values():
            ways = {chains[member][depth : depth + 1] for member in members}
            if len(members) > 1 and (len(ways) > 1 or depth == len(chains[0])):
                found.append(Shared(depth, members[0], tuple(members)))
    return found


def made_in(run: Path) -> Path:
    """The folder of a run's stages: another than its own while it replaces a finished run."""
    new = place_of_new(run)
    return new if read_marks(new) else run


def take_over(base: Path, run: Path, stages: Sequence[Stage], config: Config) -> None:
    """Make `run` a replay of this configuration that has done these stages, with the files of `base`.

    Files are hard links where the file system has them, else copies: a file of a run is replaced, never changed.
    Quadlog's earlier files in `run` are removed. Raises CannotWrite.
    """
    marks = read_marks(base)
    done = [marks[stage.name] for stage in stages if stage.name in marks]
    claim(run, replace=True)
    Run.create(run, read_record(base, unfinished=True).model_copy(update={"config": config}))
    try:
        for mark in done:
            for file in mark.files:
                _link(base / file.name, run / file.name)
    except OSError as error:
        raise CannotWrite(error.filename or run, error.strerror or str(error)) from error
    write_marks(run, done)


def _link(source: Path, target: Path) -> None:
    try:
        os.link(source, target)
    except OSError:
        part = target.with_name(f"{part_prefix(os.getpid())}{target.name}.part")
        shutil.copyfile(source, part)
        part.replace(target)


def parts(shared: Sequence[Shared]) -> Iterator[list[Shared]]:
    """Shared stages that can be done at the same time, those that others continue first."""
    for depth in sorted({each.depth for each in shared}):
        yield [each for each in shared if each.depth == depth]
