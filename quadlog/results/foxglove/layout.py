"""`foxglove-layout.json`: a Foxglove layout for `derived.mcap`, in the format that the app exports."""

from __future__ import annotations

import struct
from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from quadlog.errors import NotARun
from quadlog.messages import Float
from quadlog.results.foxglove.derived_mcap import CELLS, ERRORS
from quadlog.results.foxglove.messages import MAP_FRAME
from quadlog.results.plots.style import FIX, PLAN, RESIM, ROBOT, TARGET
from quadlog.results.run.run_folder import to_json
from quadlog.results.run.tables import has_table, read_table
from quadlog.storage.atomic_write import write_whole

_VIEW_M, _MARGIN = 10.0, 1.3  # least height of the view; ratio of the view to the walk

_MAP = {"colorMode": "gradient", "colorField": "occupied", "minValue": 0, "maxValue": 1, "drawBehind": True}
_MAP |= {"gradient": ["#00000000", "#404040ff"]}
_ARROW = {"type": "arrow", "arrowScale": [0.6, 0.15, 0.15]}
SHOWN: dict[str, dict[str, Any]] = {
    "/quadlog/map": _MAP,
    "/quadlog/scan": {"colorMode": "rgba-fields", "pointSize": 3},
    "/quadlog/pose": {**_ARROW, "color": ROBOT},
    "/quadlog/target": {"type": "axis", "axisScale": 0.5, "color": TARGET},
    "/quadlog/path": {},
    "/quadlog/path_smooth": {},
    "/quadlog/resim/pose": {**_ARROW, "color": RESIM},
    "/quadlog/resim/path_smooth": {},
    "/quadlog/uwb/anchors": {},
}
_FIX = "/quadlog/uwb/fix/"


def write_layout(run: Path) -> Path:
    """The layout into the run folder, of the topics that its `derived.mcap` has. Raises NotARun, CannotWrite."""
    path = run / "foxglove-layout.json"
    write_whole(path, to_json(_layout(_topics(run / "derived.mcap"), _walked_m(run))))
    return path


def _topics(path: Path) -> set[str]:
    try:
        with path.open("rb") as file:
            summary = make_reader(file).get_summary()
    except OSError as error:
        raise NotARun(path.parent, f"has no {path.name}") from error
    except (McapError, struct.error, ValueError) as error:
        raise NotARun(path, f"is damaged: {error}") from error
    return {channel.topic for channel in summary.channels.values()} if summary is not None else set()


def _walked_m(run: Path) -> Float:
    """Positions (N, 2) of robot and target that must be in view."""
    tables = [name for name in ("poses", "target", "control") if has_table(run, name)]
    columns = [read_table(run, name, ["x_m", "y_m"]) for name in tables]
    places = np.concatenate([np.zeros((0, 2)), *(np.column_stack([each["x_m"], each["y_m"]]) for each in columns)])
    return places[np.isfinite(places).all(axis=1)]


def _layout(topics: Collection[str], walked_m: Float) -> dict[str, Any]:
    panels = {"3D!scene": _scene(topics, walked_m)}
    if "/quadlog/cells" in topics:
        panels["Plot!expanded"] = _plot("Cells per replan", "/quadlog/cells", CELLS)
    if "/quadlog/resim/error" in topics:
        panels["Plot!error"] = _plot("Tracking error [m]", "/quadlog/resim/error", ERRORS)
    if "/quadlog/log" in topics:
        # The app's internal name of its Log panel.
        panels["RosOut!log"] = {"topicToRender": "/quadlog/log", "minLogLevel": 1, "searchTerms": []}
    scene, *beside = panels
    return {
        "configById": panels,
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": _split("row", scene, _column(beside), 62) if beside else scene,
    }


def _column(panels: list[str]) -> Any:
    """The panels in a column, equally high."""
    column: Any = panels[-1]
    for number, panel in enumerate(reversed(panels[:-1]), start=2):
        column = _split("column", panel, column, 100 / number)
    return column


def _split(direction: str, first: str, second: Any, percentage: float) -> dict[str, Any]:
    return {"direction": direction, "first": first, "second": second, "splitPercentage": percentage}


def _scene(topics: Collection[str], walked_m: Float) -> dict[str, Any]:
    """The whole walk from above, x to the right and y up, as in the figures."""
    low, high = (walked_m.min(axis=0), walked_m.max(axis=0)) if len(walked_m) else (np.zeros(2), np.zeros(2))
    x, y = ((low + high) / 2).tolist()
    shown = {name: settings for name, settings in SHOWN.items() if name in topics}
    fixes = sorted(name for name in topics if name.startswith(_FIX))
    shown |= {name: {"type": "axis", "axisScale": 0.2, "color": FIX} for name in fixes}
    return {
        "cameraState": {
            "distance": max(_VIEW_M, _MARGIN * float((high - low).max())),  # the view's height
            "perspective": False,
            "phi": 0,
            "thetaOffset": 0,
            "target": [0, 0, 0],
            "targetOffset": [x, y, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.5,
            "far": 5000,
        },
        "followMode": "follow-none",
        "followTf": MAP_FRAME,
        "scene": {"backgroundColor": "#ffffff"},
        "transforms": {},
        "topics": {name: {"visible": True, **settings} for name, settings in shown.items()},
        "layers": {},
    }


def _plot(title: str, topic: str, names: tuple[str, ...]) -> dict[str, Any]:
    """A plot of a topic of vectors; names: labels of x, y and z."""
    colors = (ROBOT, TARGET, PLAN)
    return {
        "foxglovePanelTitle": title,
        "paths": [
            {
                "value": f"{topic}.{part}",
                "label": name,
                "color": color,
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for part, name, color in zip("xyz", names, colors, strict=False)
        ],
        "xAxisVal": "timestamp",
        "showLegend": True,
        "legendDisplay": "floating",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
    }
