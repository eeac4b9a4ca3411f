"""The machine and the packages a run was made with."""

from __future__ import annotations

import os
import platform
from functools import cache
from importlib import metadata
from typing import Any

_PACKAGES = (
    *("daqp", "foxglove-sdk", "llvmlite", "matplotlib", "mcap", "mcap-protobuf-support"),
    *("mujoco", "numba", "numpy", "open3d", "open3d-cpu", "pandas", "pyarrow", "pydantic", "rosbags"),
    *("scipy", "small_gicp"),
)


def describe_host() -> dict[str, Any]:
    """Name, system, machine, Python and number of processors: what a timing depends on."""
    return {
        "name": platform.node(),
        "system": platform.platform(),
        "machine": platform.machine(),
        "python": platform.python_version(),
        "processors": os.cpu_count() or 1,
    }


@cache
def package_versions() -> dict[str, str]:
    """Versions of the packages that results depend on; those not installed are left out."""
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return versions
