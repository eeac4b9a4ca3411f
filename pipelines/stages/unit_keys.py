"""A digest of all that a unit's results depend on: the same key, the same results."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any
from uuid import uuid4

from quadlog.config import Config
from quadlog.errors import QuadlogError
from quadlog.pipelines.stages.units import CONTROL, PLAN, POSITION, Unit, units_until
from quadlog.plugins import DECODERS, PLANNERS, all_plugins
from quadlog.results.host import package_versions
from quadlog.results.record import RUN_FORMAT
from quadlog.version import __version__

if TYPE_CHECKING:
    from quadlog.pipelines.replay import ReplayRequest

_MSG_PATTERNS = ("*.msg", "*/*.msg", "*/msg/*.msg")
"""Where definitions are looked for below a folder of --msg-path."""


def unit_keys(request: ReplayRequest, identity: str) -> dict[Unit, str]:
    """The key of each unit that a request asks for; each has those before it in it. identity: the input's."""
    keys: dict[Unit, str] = {}
    key = _digest(_common(request, identity))
    for unit in units_until(request.options.until):
        config = {name: _value(request.config, name) for name in unit.reads}
        key = _digest([key, unit.stages, config, _named_by_config(unit, request.config)])
        keys[unit] = key
    return keys


def _common(request: ReplayRequest, identity: str) -> dict[str, Any]:
    """What every unit depends on; not until which one is asked for."""
    options = request.options
    return {
        "input": identity,
        "options": [options.stamp, options.start_s, options.duration_s, options.seed],
        "definitions": [_folder_digest(folder) for folder in options.msg_path],
        "decoders": _plugins(DECODERS),
        "quadlog": [__version__, RUN_FORMAT],
        "packages": package_versions(),
        # Compiled code may round otherwise on another kind of machine.
        "machine": [platform.python_version(), platform.system(), platform.machine()],
    }


def _named_by_config(unit: Unit, config: Config) -> Any:
    """The content of what a unit's configuration only names."""
    if unit == POSITION:
        return _file_digest(Path(config.topics.position))
    if unit == PLAN:
        return [each for each in _plugins(PLANNERS) if each[0] == config.planner.name]
    if unit == CONTROL and config.simulation.has_body:
        return _model_digest(config.robot.model)
    return None


def _value(config: Config, name: str) -> Any:
    """The value of a dotted key, or the whole section, as JSON has it."""
    value: Any = config
    for part in name.split("."):
        value = getattr(value, part)
    return value.model_dump(mode="json") if hasattr(value, "model_dump") else value


def _plugins(group: str) -> list[tuple[str, str, str]]:
    """Name, distribution and version of each: which of the decoders take part shows only in the recording."""
    return [(each.name, each.distribution, each.version) for each in all_plugins() if each.group == group]


def _file_digest(path: Path) -> str | None:
    """Of a file's content; None for what is no file. One that cannot be read is never the same."""
    try:
        if not path.is_file():
            return None
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return uuid4().hex


def _folder_digest(folder: Path) -> str:
    """Of the message definitions in a folder, by name."""
    return _digest([(path.relative_to(folder).as_posix(), _file_digest(path)) for path in _definitions(folder)])


def _definitions(folder: Path) -> Iterator[Path]:
    for pattern in _MSG_PATTERNS:
        yield from sorted(folder.glob(pattern))


def _model_digest(model: str) -> str | None:
    """Of a robot's file with all that it includes; None for quadlog's own robots, told by name."""
    from quadlog.locomotion.robot import ROBOTS

    if model in ROBOTS:
        return None
    from quadlog.simulation.model_files import content_digest

    try:
        return content_digest(Path(model))
    except QuadlogError:
        return uuid4().hex  # whoever walks with it says what is wrong


def _digest(content: dict[str, Any] | Sequence[Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
