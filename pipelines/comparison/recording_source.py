"""A recording: its maps are made first, as `quadlog replay --until map` would, and kept only while they are needed."""

from __future__ import annotations

from pathlib import Path

from quadlog.config import Config
from quadlog.errors import MissingInput
from quadlog.pipelines.comparison.run_source import run_source
from quadlog.pipelines.comparison.source import Source
from quadlog.pipelines.progress import Progress
from quadlog.pipelines.replay import ReplayOptions, ReplayRequest, replay
from quadlog.results.tables import has_table


def recording_source(
    recording: Path, name: str, config: Config, folder: Path, seed: int, progress: Progress
) -> tuple[Source, str]:
    """(its questions, what of it was lost); the run goes to `folder`. Raises what a replay raises."""
    request = ReplayRequest(recording, folder, config, ReplayOptions(until="map", seed=seed))
    try:
        outcome = replay(request, progress)
    except MissingInput as error:
        # Where a replay of several recordings says which one it is, and may stop before the maps.
        remedy = "planners are compared on maps, which need one" if error.stage == "filter" else error.remedy
        raise MissingInput(error.stage, f"{recording}: {error.needed}", remedy) from error
    if not has_table(folder, "target"):
        remedy = "choose one with  --set topics.target=ahead  or, for a robot that stands, fixed"
        raise MissingInput("plan", f"{recording} shows no target", remedy)
    return run_source(folder, name), outcome.reason
