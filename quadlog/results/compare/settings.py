"""Settings of runs: which of them differ, so that only runs made alike are averaged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from quadlog.errors import printable, some_of
from quadlog.results.compare.differences import flatten

_OF_THE_RECORDING = ("topics", "uwb.anchors", "uwb.tags", "uwb.range_topics", "lidar.mount")
"""Facts about a recording and its robot, which may differ between recordings replayed alike."""
_OF_THE_SAMPLE = ("seed", "start_s", "duration_s", "until", "msg_path")
"""Options that choose what is read and drawn, not how."""


def settings_of(record: Mapping[str, Any]) -> dict[str, object]:
    """Configuration and options of a run.json by key, without what is drawn or measured for each recording."""
    config, options = (value if isinstance(value, dict) else {} for value in map(record.get, ("config", "options")))
    keys = {key: value for key, value in flatten(config).items() if not key.startswith(_OF_THE_RECORDING)}
    return {**keys, **{key: value for key, value in flatten(options).items() if key not in _OF_THE_SAMPLE}}


def differing_settings(runs: Sequence[Mapping[str, object]]) -> list[str]:
    """A line `key: value, value` for each setting in which the runs differ, none for one run."""
    lines = []
    for key in dict.fromkeys(key for run in runs for key in run):
        values = list(dict.fromkeys(str(run.get(key, "not set")) for run in runs))
        if len(values) > 1:
            lines.append(printable(f"{key}: {some_of(values)}"))
    return lines
