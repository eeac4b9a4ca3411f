"""Reuse of earlier results: finished runs, and single stages of a run folder."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path, PurePosixPath
from typing import Any
from uuid import uuid4

from pydantic import ConfigDict, ValidationError

from quadlog.config.plugins import DECODERS, PLANNERS, all_plugins, is_installed
from quadlog.config.schema import Config
from quadlog.config.version import package_versions
from quadlog.errors import ExitCode, NotARun, QuadlogError, RunOfAnother, UnknownRunFormat
from quadlog.metrics.walking import Effort
from quadlog.pipelines.request import ReplayOutcome, ReplayRequest
from quadlog.pipelines.stages.context import ReplayContext, RobotTrack, TargetTrack, WalkedBody, WhatWasRead
from quadlog.pipelines.stages.stage import CONTROL, PLAN, POSITION, Stage, stages_for
from quadlog.recordings.containers.container import Loss
from quadlog.results.record import RUN_FORMAT, InputRecord, RunRecord, describe_input, read_metrics, read_record
from quadlog.results.stage_marks import (
    MARKS_FILE,
    Marked,
    StageMark,
    files_are_whole,
    mark_files,
    read_marks,
    write_marks,
)
from quadlog.results.stages import STAGES, stages_until
from quadlog.storage.atomic_write import files_written
from quadlog.version import __version__


def finished_outcome(request: ReplayRequest) -> ReplayOutcome | None:
    """The outcome of an earlier run with the very same input, config, options and version; None when there is none."""
    if not (request.run / "run.json").is_file():
        return None
    return outcome_there(request, request.described or describe_input(request.recording))


def outcome_there(request: ReplayRequest, described: InputRecord) -> ReplayOutcome | None:
    """The same for an input that is described already. A run of a later --until is finished, too."""
    try:
        record = read_record(request.run)
    except (NotARun, UnknownRunFormat):
        return None
    config = record.config
    if record.anchors_from_messages:
        config = config.model_copy(update={"uwb": config.uwb.model_copy(update={"anchors": Config().uwb.anchors})})
    until = str(record.options.get("until"))
    same = (
        record.input.identity == described.identity
        and record.quadlog_version == __version__
        and config == request.config
        and record.options == json.loads(json.dumps(request.options.to_dict())) | {"until": until}
        and until in STAGES[STAGES.index(request.options.until) :]
    )
    return _outcome(request, until, record) if same else None


def refuse_another(request: ReplayRequest, described: InputRecord) -> None:
    """Raises RunOfAnother for a finished run of another recording, which cannot be resumed for this one."""
    try:
        recorded = read_record(request.run).input
    except (NotARun, UnknownRunFormat):
        return
    if recorded.identity != described.identity and not _may_be_one(recorded.path, str(request.recording)):
        raise RunOfAnother(request.run, recorded.path)


def _outcome(request: ReplayRequest, until: str, record: RunRecord) -> ReplayOutcome | None:
    """The outcome of a run that is finished until `until`, None if files of its stages or its page are missing."""
    marks = read_marks(request.run)
    if until == "report" and request.draws and not (request.run / "report.html").is_file():
        return None
    try:
        metrics = read_metrics(request.run)
    except NotARun:
        return None
    # A log without a lidar ends after `position`.
    ran = {each.name for each in record.stages}
    done = [stage for stage in stages_for(until) if stage is POSITION or ran.intersection(stage.names)]
    if not all(stage.name in marks and files_are_whole(request.run, marks[stage.name]) for stage in done):
        return None
    if any(not is_installed(**each.model_dump()) for each in record.plugins):
        return None
    reason = "; ".join(loss.detail for loss in record.losses)
    code = ExitCode.WITH_LOSS if reason else ExitCode.DONE
    reused = stages_until(request.options.until)[1:]
    return ReplayOutcome(request.recording, request.run, code, reason, metrics, reused)


def _may_be_one(saved: str, asked: str) -> bool:
    """Whether two paths may be of one recording: one ends with the other."""
    one, other = (PurePosixPath(text.replace("\\", "/")).parts for text in (saved, asked))
    shorter = min(len(one), len(other))
    return bool(shorter) and one[-shorter:] == other[-shorter:]


class _Took(Marked):
    """Time and memory of a stage."""

    seconds: float
    peak_memory_mb: float


class _Robot(Marked):
    """Source and frame of a RobotTrack; the frame is in no table."""

    source: str
    frame_id: str


class Known(Marked):
    """The state of a replay after a stage, as the stage's mark saves it.

    losses, read_warnings: of the recording, as far as it was read by then.
    """

    model_config = ConfigDict(strict=False)  # dataclasses are read from JSON's objects

    first_ns: int
    last_ns: int
    robot: _Robot | None
    target_source: str | None
    used: dict[str, list[str]]
    counts: dict[str, int]
    notes: list[str]
    warnings: list[str]
    own_losses: list[Loss]
    losses: list[Loss]
    read_warnings: list[str]
    body: WalkedBody | None
    stages: dict[str, _Took]


def note_known(walk: ReplayContext, stage: Stage) -> Known:
    """The state to save after a stage."""
    robot, target, body, clock = walk.robot, walk.target, walk.body, walk.clock
    return Known(
        first_ns=int(walk.first_ns),
        last_ns=int(walk.last_ns),
        robot=None if robot is None else _Robot(source=robot.source, frame_id=robot.frame_id),
        target_source=None if target is None else target.source,
        used={role: list(topics) for role, topics in walk.used.items()},
        counts={name: int(count) for name, count in walk.counts.items()},
        notes=walk.notes,
        warnings=walk.own_warnings,
        own_losses=walk.own_losses,
        losses=walk.read_losses,
        read_warnings=walk.read_warnings,
        body=None if body is None else WalkedBody(float(body.mass_kg), int(body.ticks), _plain(body.effort)),
        stages={
            name: _Took(seconds=clock.seconds[name], peak_memory_mb=clock.peak_memory_mb[name])
            for name in stage.names
            if name in clock.seconds
        },
    )


def known_of(mark: StageMark) -> Known | None:
    """The state saved in a mark; None if it is damaged."""
    try:
        return Known.model_validate(mark.known)
    except (ValidationError, RecursionError):
        return None


def hand_over(known: Known, stage: Stage, walk: ReplayContext) -> None:
    """Restore the state after a stage. Raises NotARun for damaged tables."""
    run = walk.run.path
    walk.first_ns, walk.last_ns = known.first_ns, known.last_ns
    if known.robot is not None:
        walk.robot = RobotTrack.read(run, known.robot.frame_id)
    if known.target_source is not None:
        walk.target = TargetTrack.read(run)
    walk.used = {role: tuple(topics) for role, topics in known.used.items()}
    walk.counts = dict(known.counts)
    walk.notes, walk.own_warnings = list(known.notes), list(known.warnings)
    walk.own_losses = list(known.own_losses)
    walk.body = known.body
    if "filter" in stage.names:
        walk.read_before = WhatWasRead(known.losses, known.read_warnings)
    for name, took in known.stages.items():
        walk.clock.seconds[name], walk.clock.peak_memory_mb[name] = took.seconds, took.peak_memory_mb


def _plain(effort: Effort) -> Effort:
    """Without numpy's numbers, which JSON does not know."""
    return Effort(**{name: float(value) for name, value in asdict(effort).items()})


_MSG_PATTERNS = ("*.msg", "*/*.msg", "*/msg/*.msg")
"""Where definitions are looked for below a folder of --msg-path."""


def stage_keys(request: ReplayRequest, identity: str) -> dict[Stage, str]:
    """The key of each stage of a request, which includes the key of the stage before. identity: of the input."""
    keys: dict[Stage, str] = {}
    key = _digest(_common(request, identity))
    for stage in stages_for(request.options.until):
        config = {name: _value(request.config, name) for name in stage.reads}
        seed = request.options.seed if _draws_numbers(stage, request.config) else None
        key = _digest([key, stage.names, config, _named_by_config(stage, request.config), seed])
        keys[stage] = key
    return keys


def _common(request: ReplayRequest, identity: str) -> dict[str, Any]:
    """What every stage depends on; --until is not part of it."""
    options = request.options
    return {
        "input": identity,
        "options": [options.stamp, options.start_s, options.duration_s],
        "definitions": [_folder_digest(folder) for folder in options.msg_path],
        "decoders": _plugins(DECODERS),
        "quadlog": [__version__, RUN_FORMAT],
        "packages": package_versions(),
        # Compiled code may round otherwise on another kind of machine.
        "machine": [platform.python_version(), platform.system(), platform.machine()],
    }


def _draws_numbers(stage: Stage, config: Config) -> bool:
    """Whether a stage draws random numbers: the papers' fit of the ground, and disturbances in the re-simulation."""
    return stage is CONTROL or ("filter" in stage.names and config.lidar.method == "paper")


def _named_by_config(stage: Stage, config: Config) -> Any:
    """Digests of files and versions of plug-ins that a stage's configuration names."""
    if stage == POSITION:
        return [_file_digest(Path(config.topics.position)), _model_digest(config.robot.model, unreadable="")]
    if stage == PLAN:
        return [each for each in _plugins(PLANNERS) if each[0] == config.planner.name]
    if stage == CONTROL and config.simulation.has_body:
        return _model_digest(config.robot.model)
    return None


def _value(config: Config, name: str) -> Any:
    """The value of a dotted key, or the whole section, as JSON has it."""
    value: Any = config
    for part in name.split("."):
        value = getattr(value, part)
    return value.model_dump(mode="json") if hasattr(value, "model_dump") else value


def _plugins(group: str) -> list[tuple[str, str, str]]:
    """Name, distribution and version of each plug-in of a group."""
    return [(each.name, each.distribution, each.version) for each in all_plugins() if each.group == group]


def _file_digest(path: Path) -> str | None:
    """Digest of a file; None if there is none. An unreadable file gets a random one, and is never equal."""
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return uuid4().hex


def _folder_digest(folder: Path) -> str:
    """Digest of the message definitions in a folder."""
    return _digest([(path.relative_to(folder).as_posix(), _file_digest(path)) for path in _definitions(folder)])


def _definitions(folder: Path) -> Iterator[Path]:
    for pattern in _MSG_PATTERNS:
        yield from sorted(folder.glob(pattern))


def _model_digest(model: str, unreadable: str | None = None) -> str | None:
    """Digest of a robot's file and its includes; None for the name of one of quadlog's own robots.

    unreadable: of a file that cannot be read; None for one that never equals another, where the robot is needed.
    """
    from quadlog.control.locomotion.robot import ROBOTS

    if model in ROBOTS:
        return None
    from quadlog.simulation.robot.model_files import content_digest

    try:
        return content_digest(Path(model))
    except QuadlogError:
        # The stage that loads it raises the error.
        return uuid4().hex if unreadable is None else unreadable


def _digest(content: dict[str, Any] | Sequence[Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


Earlier = Mapping[Stage, StageMark]
"""Marks of reusable stages, in order, from the first one on."""


def find_reusable(request: ReplayRequest, identity: str) -> Earlier:
    """The stages whose key is the same as now and whose files are unchanged. identity: of the input."""
    found: dict[Stage, StageMark] = {}
    marks = read_marks(request.run)
    for stage, key in stage_keys(request, identity).items() if marks else ():
        mark = marks.get(stage.name)
        if mark is None or mark.key != key or known_of(mark) is None or not files_are_whole(request.run, mark):
            break
        found[stage] = mark
    return found


def names_of(earlier: Earlier) -> tuple[str, ...]:
    """Names of the reusable stages."""
    return tuple(name for stage in earlier for name in stage.names)


class MarkedStages:
    """Run the stages of a replay: reusable ones are restored, the others are done and marked."""

    def __init__(self, walk: ReplayContext, request: ReplayRequest, earlier: Earlier) -> None:
        self._walk, self._earlier = walk, earlier
        self._keys = stage_keys(request, walk.input.identity)
        self._marks: list[StageMark] = []
        walk.reused = names_of(earlier)
        walk.keep = (MARKS_FILE, *(file.name for mark in earlier.values() for file in mark.files)) if earlier else ()

    def do(self, stage: Stage, work: Callable[[ReplayContext], None]) -> None:
        """Restore or run one stage. Raises what the work raises."""
        walk = self._walk
        if (mark := self._earlier.get(stage)) is not None:
            known = Known.model_validate(mark.known)
            walk.begin_folder()
            hand_over(known, stage, walk)
            self._note(mark)
            return
        with files_written() as written:
            work(walk)
        known = note_known(walk, stage)
        # Files written, not files present: another process may have removed one, which must be an error.
        files = mark_files(walk.run.path, [name for name in stage.files if walk.run.path / name in written])
        self._note(StageMark(stage=stage.name, key=self._keys[stage], files=files, known=known.model_dump()))
        write_marks(walk.run.path, self._marks)

    def _note(self, mark: StageMark) -> None:
        self._marks.append(mark)
        self._walk.left |= {MARKS_FILE, *(file.name for file in mark.files)}
