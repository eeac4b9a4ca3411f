"""The run folder: written, read, drawn and exported."""

from typing import Any


def __getattr__(name: str) -> Any:
    """`quadlog.results.load_maps`, imported on first use."""
    if name != "load_maps":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from quadlog.results.arrays import load_maps

    return load_maps
