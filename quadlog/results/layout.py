"""`foxglove-layout.json`: a Foxglove layout that shows `derived.mcap` at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from quadlog.results.files import write_whole
from quadlog.results.run_folder import to_json

_FIXES, _ROBOT, _TARGET, _RESIM = "#56b4e9", "#0072b2", "#d55e00", "#009e73"


def write_layout(run: Path) -> Path:
    """The layout, the same for every run, into the run folder. Raises CannotWrite."""
    path = run / "foxglove-layout.json"
    write_whole(path, to_json(_layout()))
    return path


def _layout() -> dict[str, Any]:
    plots = {
        "direction": "column",
        "first": "Plot!expanded",
        "second": {"direction": "column", "first": "Plot!error", "second": "Log!metrics", "splitPercentage": 50},
        "splitPercentage": 34,
    }
    return {
        "configById": {
            "3D!scene": _scene(),
            "Plot!expanded": _plot("Cells per replan", "/quadlog/plan", "expanded", "generated"),
            "Plot!error": _plot(
                "Tracking error [m]", "/quadlog/resim/error", "error_m", "cross_track_m", "time_error_m"
            ),
            "Log!metrics": {"topicToRender": "/quadlog/metrics", "minLogLevel": 1, "searchTerms": []},
        },
        "globalVariables": {},
        "userNodes": {},
        "playbackConfig": {"speed": 1},
        "layout": {"direction": "row", "first": "3D!scene", "second": plots, "splitPercentage": 62},
    }


def _scene() -> dict[str, Any]:
    topics: dict[str, Any] = {
        "/quadlog/map": {
            "colorField": "occupied",
            "colorMode": "gradient",
            "gradient": ["#00000000", "#404040ff"],
            "minValue": 0,
            "maxValue": 1,
        },
        "/quadlog/pose": {"type": "arrow", "arrowScale": [0.6, 0.15, 0.15], "color": _ROBOT},
        "/quadlog/target": {"type": "axis", "axisScale": 0.5, "color": _TARGET},
        "/quadlog/path": {"type": "line", "lineWidth": 0.04, "gradient": [_FIXES, _FIXES]},
        "/quadlog/path_smooth": {"type": "line", "lineWidth": 0.06, "gradient": [_ROBOT, _ROBOT]},
        "/quadlog/resim/pose": {"type": "arrow", "arrowScale": [0.6, 0.15, 0.15], "color": _RESIM},
        "/quadlog/resim/path_smooth": {"type": "line", "lineWidth": 0.06, "gradient": [_RESIM, _RESIM]},
    }
    # Tags are numbered as the user numbered them; the usual ones are switched on.
    topics |= {f"/quadlog/uwb/fix/{tag}": {"type": "axis", "axisScale": 0.2, "color": _FIXES} for tag in range(8)}
    return {
        "cameraState": {
            "distance": 25,
            "perspective": False,
            "phi": 0,
            "thetaOffset": 90,
            "target": [0, 0, 0],
            "targetOffset": [0, 0, 0],
            "targetOrientation": [0, 0, 0, 1],
            "fovy": 45,
            "near": 0.5,
            "far": 5000,
        },
        "followMode": "follow-position",
        "followTf": "base",
        "scene": {"backgroundColor": "#ffffff"},
        "transforms": {},
        "topics": {name: {"visible": True, **settings} for name, settings in topics.items()},
        "layers": {},
    }


def _plot(title: str, topic: str, *fields: str) -> dict[str, Any]:
    colors = (_ROBOT, _TARGET, _RESIM)
    return {
        "title": title,
        "foxglovePanelTitle": title,
        "paths": [
            {
                "value": f"{topic}.{field}",
                "label": field,
                "color": color,
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for field, color in zip(fields, colors, strict=False)
        ],
        "xAxisVal": "timestamp",
        "showLegend": True,
        "legendDisplay": "floating",
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "isSynced": True,
    }
