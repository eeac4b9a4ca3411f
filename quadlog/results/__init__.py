"""The run folder: written, read, drawn and exported.

For users' scripts: `load_maps(run)`, `read_table(run, name)`, `read_run_json(run)`, `read_metrics(run)`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from quadlog.results.run.maps import load_maps as load_maps
    from quadlog.results.run.run_folder import read_metrics as read_metrics
    from quadlog.results.run.run_folder import read_run_json as read_run_json
    from quadlog.results.run.tables import read_table as read_table

_HOMES = {
    "load_maps": "quadlog.results.run.maps",
    "read_metrics": "quadlog.results.run.run_folder",
    "read_run_json": "quadlog.results.run.run_folder",
    "read_table": "quadlog.results.run.tables",
}


def __getattr__(name: str) -> Any:
    """Import on first use, since numpy and pyarrow are slow to import."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)
