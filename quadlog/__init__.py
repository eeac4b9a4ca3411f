"""quadlog: replay what a quadruped logged through every algorithm worth comparing.

From Python:

    run = quadlog.replay("walk.mcap", settings={"planner.name": "astar"})   # or quadlog.load_run("runs/walk")
    run.metric("eta_m"), run.table("poses"), run.maps.occupied(0)
    with quadlog.open_recording("walk.mcap") as recording:
        for t_ns, topic, message in recording.messages(["/points"]): ...

Everything that goes wrong and a caller can mend is a QuadlogError.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from quadlog.version import __version__

if TYPE_CHECKING:
    from quadlog.errors import QuadlogError
    from quadlog.pipelines.api import replay
    from quadlog.recordings.recording import Recording, open_recording
    from quadlog.results.run import Run, load_run

_HOMES = {
    "QuadlogError": "quadlog.errors",
    "Recording": "quadlog.recordings.recording",
    "Run": "quadlog.results.run",
    "load_run": "quadlog.results.run",
    "open_recording": "quadlog.recordings.recording",
    "replay": "quadlog.pipelines.api",
}

__all__ = ["QuadlogError", "Recording", "Run", "__version__", "load_run", "open_recording", "replay"]


def __getattr__(name: str) -> Any:
    """Imported on first use: numpy and pyarrow take longer than `quadlog --help`."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    found = globals()[name] = getattr(import_module(_HOMES[name]), name)
    return found


def __dir__() -> list[str]:
    """With what is not imported yet, for those who press the tab key."""
    return sorted({*globals(), *__all__})
