"""The run folder: written, read, drawn and exported.

For users' scripts: `load_maps(run)`, `read_table(run, name)`, `read_record(run)`, `read_metrics(run)`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from quadlog.results.record import read_record as read_record
    from quadlog.results.saved.maps import load_maps as load_maps
    from quadlog.results.saved.run_folder import read_metrics as read_metrics
    from quadlog.results.saved.tables import read_table as read_table

_HOMES = {
    "load_maps": "quadlog.results.saved.maps",
    "read_metrics": "quadlog.results.saved.run_folder",
    "read_record": "quadlog.results.record",
    "read_table": "quadlog.results.saved.tables",
}


def __getattr__(name: str) -> Any:
    """Import on first use, since numpy and pyarrow are slow to import."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(_HOMES[name]), name)
