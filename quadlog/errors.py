"""What can go wrong: a class for each cause that somebody handles, or that several places raise.

Every class carries its data, says in one line what happened and what to do,
and knows its exit code. The command line prints ``str(error)`` and nothing
else; anything that is not a QuadlogError is a bug in quadlog.
"""

from __future__ import annotations

import copyreg
import csv
import io
import re
import shlex
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from enum import IntEnum
from pathlib import Path
from typing import Any

_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_NUMBER = re.compile(r"[+-][0-9]+(\.[0-9]+)?(e[+-]?[0-9]+)?")


def printable(text: object) -> str:
    """One line without control characters, which a terminal would obey: white space becomes a space."""
    other = "\N{REPLACEMENT CHARACTER}"
    return "".join(c if c.isprintable() else " " if c.isspace() else other for c in str(text))


def clipped(text: object, most: int = 200) -> str:
    """The text, or its beginning and how much longer it is: a name in a damaged file can be megabytes long."""
    words = str(text)
    return words if len(words) <= most else f"{words[:most]}... ({len(words) - most} more characters)"


def nearest(name: str, names: Iterable[str]) -> str | None:
    """The name that was most likely meant: the shortest that begins so, else the most alike; None without one."""
    names = list(names)
    begun = sorted((each for each in names if name and each.startswith(name.lower())), key=len)
    return next(iter([*begun, *get_close_matches(name.lower(), names, n=1, cutoff=0.5)]), None)


MAX_LISTED = 20


def some_of(names: Sequence[str], most: int = MAX_LISTED, between: str = ", ") -> str:
    """The names, or the first of them and how many more there are."""
    more = [f"and {len(names) - most} more"] if len(names) > most else []
    return between.join([*map(clipped, names[:most]), *more])


def set_flag(key: str, values: Sequence[str]) -> str:
    """`--set key=value` to paste into a shell: one value as it is, several as a TOML list.

    What a terminal would obey is written as TOML's escape, so that the flag means the very same name.
    """
    if len(values) == 1 and values[0].startswith("/") and values[0].isprintable() and values[0] == values[0].strip():
        value = values[0]  # no TOML value starts with a slash: it is taken as text
    elif len(values) == 1:
        value = _toml_string(values[0])
    else:
        value = f"[{', '.join(map(_toml_string, values))}]"
    return f"--set {shlex.quote(f'{key}={value}')}"


def csv_table(rows: Iterable[Iterable[object]]) -> str:
    """Rows as CSV, texts so that no spreadsheet takes them for formulas."""
    lines = []
    for row in rows:
        line = io.StringIO(newline="")
        # A carriage return in a text is quoted only where lines end with one.
        csv.writer(line, lineterminator="\r\n").writerow([csv_cell(each) for each in row])
        lines.append(line.getvalue().removesuffix("\r\n"))
    return "".join(f"{line}\n" for line in lines)


def csv_cell(value: object) -> object:
    """A text that begins like a formula behind an apostrophe, as spreadsheets have it; numbers stay what they are."""
    formula = isinstance(value, str) and value.startswith(_FORMULA) and not _NUMBER.fullmatch(value)
    return f"'{value}" if formula else value


def _toml_string(text: str) -> str:
    escaped = (each if each.isprintable() else f"\\U{ord(each):08X}" for each in re.sub(r'["\\]', r"\\\g<0>", text))
    return f'"{"".join(escaped)}"'


class ExitCode(IntEnum):
    """What the process's exit code means, for scripts."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    WITH_LOSS = 3
    CHECK_FAILED = 4


class QuadlogError(Exception):
    """Something a user can cause and mend."""

    exit_code = ExitCode.FAILED

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickled with its attributes: exceptions are otherwise made again from their message alone."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class UsageError(QuadlogError):
    """The command line names something that does not exist, or options that contradict one another."""

    exit_code = ExitCode.USAGE


class Interrupted(QuadlogError):
    """A signal ended the command: Ctrl-C, or the one that is named."""

    def __init__(self, signal_name: str = "") -> None:
        super().__init__(f"interrupted by {signal_name}" if signal_name else "interrupted")


class FileError(QuadlogError):
    """A file, folder or URL (path) that cannot be used, and why in one phrase (reason)."""

    template = "{path}: {reason}"
    usual = ""  # the reason where none is given

    def __init__(self, path: Path | str, reason: str = "") -> None:
        self.path, self.reason = path, reason or self.usual
        super().__init__(self.template.format(path=path, reason=self.reason))


class RecordingNotFound(FileError):
    """No such file or folder, or a folder without recordings."""

    usual = "no such file or folder"


class NotARecording(FileError):
    """The file exists, but is not in a format that quadlog reads."""

    template = "{path}: {reason} (quadlog reads .mcap, .bag, .db3 and ROS 2 bag folders)"


class NothingReadable(FileError):
    """A recording so damaged, or so unknown, that not one message could be read from it."""

    template = "{path}: nothing readable: {reason}"


class NothingToReplay(NothingReadable):
    """An intact recording without a message that quadlog uses."""

    template = "{path}: nothing to replay (see  quadlog info): {reason}"


class StorageFailed(FileError):
    """A server that cannot be reached, refuses, does not answer in time, or answers what cannot be right."""


class StorageChanged(FileError):
    """An object that was replaced while it was read: its bytes would be those of two recordings."""

    usual = "it changed on the server while it was read; start again when it is whole"


class DecodeError(QuadlogError):
    """One message could not be decoded. Readers count it as a loss and go on."""

    def __init__(self, topic: str, reason: str) -> None:
        self.topic, self.reason = topic, reason
        super().__init__(f"{topic}: {reason}")


class UnknownJoints(DecodeError):
    """A message that does not name joints of four legs: of another machine, or with names that must be configured.

    remedy: empty for another machine.
    """

    def __init__(self, topic: str, names: Sequence[str], remedy: str = "") -> None:
        self.names, self.remedy = tuple(names), remedy
        listed = some_of([name[:40] for name in names]) or "none"
        super().__init__(topic, f"names no joint of four legs, but {listed}{remedy}")


class AmbiguousTopic(QuadlogError):
    """Several topics, or several groups of topics, could play one role. Lists the choices as flags to paste."""

    def __init__(self, role: str, choices: Iterable[Sequence[str]]) -> None:
        groups = list(choices)
        several = "topics" if all(len(topics) == 1 for topics in groups) else "groups of topics"
        what = f"{len(groups)} {several}" if len(groups) != 1 else "one topic"
        flags = [set_flag(f"topics.{role}", topics) for topics in groups[:MAX_LISTED]]
        if (more := len(groups) - MAX_LISTED) > 0:
            flags.append(f"one of {more} more")
        super().__init__(f"{what} could be the {role}; choose with  {'  or  '.join(flags)}")


class UnknownTopic(QuadlogError):
    """A topic that the recording does not have, or of another type than its role in the configuration, if any."""

    def __init__(
        self, role: str | None, topic: str, choices: Sequence[str], why: str = "is not in the recording"
    ) -> None:
        where = f"topics.{role}: " if role else ""
        super().__init__(f"{where}{topic} {why}; topics of the recording: {some_of(choices) or 'none'}")


class MissingInput(QuadlogError):
    """A stage needs something that neither the recording nor the configuration gives."""

    def __init__(self, stage: str, needed: str, remedy: str) -> None:
        self.stage, self.needed, self.remedy = stage, needed, remedy
        super().__init__(f"{stage}: {needed}; {remedy}")


class ClocksDiffer(QuadlogError):
    """Two clocks of one recording, header stamps or log time, lie more than an hour apart and would be mixed."""

    def __init__(self, path: Path | str, apart_s: float, first: str, second: str) -> None:
        super().__init__(
            f"{path}: {first} and {second} lie {apart_s:.0f} s apart and cannot be compared; "
            "use  --stamp log  to take log times for all"
        )


class UnknownConfigKey(QuadlogError):
    """A key that no section has; the nearest valid one is named."""

    def __init__(self, key: str, nearest: str | None, source: str) -> None:
        hint = f"; did you mean {nearest}?" if nearest else ""
        super().__init__(f"{source}: unknown key {clipped(key)}{hint}")


class InvalidConfigValue(QuadlogError):
    """A key whose value has the wrong type or lies outside its bounds."""

    def __init__(self, key: str, reason: str, source: str) -> None:
        super().__init__(f"{source}: {clipped(key)}: {reason}")


class UnknownName(QuadlogError):
    """A planner, method, scenario or format that quadlog does not have; lists those it has."""

    def __init__(self, kind: str, name: str, choices: Iterable[str]) -> None:
        self.kind, self.name, self.choices = kind, name, sorted(choices)
        near = nearest(name, self.choices)
        meant = f"did you mean {near}? " if near else ""
        super().__init__(f"unknown {kind} {name!r}; {meant}choose one of: {', '.join(self.choices)}")


class AlreadyExists(FileError):
    """An output that would be overwritten."""

    template = "{path} exists: use {reason}"
    usual = "--force to replace it"


class RunExists(AlreadyExists):
    """A run folder that is there already."""

    usual = "--force to replace it or --resume to continue"


class RunOfAnother(QuadlogError):
    """A finished run that is to be completed, but was made from another recording."""


class NotARun(FileError):
    """A folder that is no finished run, or one with a damaged or missing file."""


class TooLarge(QuadlogError):
    """A size from an untrusted input exceeds what quadlog is willing to allocate."""

    def __init__(self, what: str, size: int, limit: int) -> None:
        super().__init__(f"{what}: {size} exceeds the limit of {limit}")


class CannotWrite(FileError):
    """An output that could not be written: a full disk, a missing permission, a folder in the way."""

    template = "{path}: cannot be written: {reason}"


class WorkerDied(QuadlogError):
    """A worker process has ended during a task."""


class VersionsDiffer(QuadlogError):
    """A worker with other package versions than this process."""


class UnreadableFile(FileError):
    """A file that the user named, a trajectory or a map, and that is not what its format says."""

    def __init__(self, path: Path | str, reason: str, line: int | None = None) -> None:
        super().__init__(f"{path}, line {line}" if line is not None else path, reason)


class UnusableRobot(FileError):
    """A robot model that quadlog cannot walk; reason: what it needs."""

    template = "{path}: quadlog cannot walk this robot; it needs {reason}"


class AnchorsNotObserved(QuadlogError):
    """A walk that does not show where the anchors stand; what to walk instead."""

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(f"survey: {reason}; {remedy}")


class UnknownRunFormat(FileError):
    """A run folder that another version of quadlog wrote, in a format that this one does not read."""

    template = "{path}: is a run of format {reason}"


class UnknownMetric(UsageError):
    """A name that no metric has, or a condition on a metric that does not read NAME OPERATOR NUMBER."""


class NoCommonTime(FileError):
    """A trajectory and a reference of which no two poses are near in time: another clock, or another recording."""

    template = "{path}: cannot be compared with {reason}"
