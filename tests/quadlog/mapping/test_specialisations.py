"""Every specialisation of a compiled function costs the first start a share of a second."""

from __future__ import annotations

import subprocess
import sys

_SCANS = """
import sys
import numpy as np
from numba.core.registry import CPUDispatcher
from quadlog.lidar.scan_classifier import RangeImageSettings, ScanClassifier
from quadlog.mapping.grid import GrowingLattice, SlidingLattice, window_around
from quadlog.mapping.memory import GroundHeight, LogOddsMemory
from quadlog.mapping.placing import PlacingSettings, place_scan
from quadlog.messages import PointCloud
from tests.lab.labelled_scans import labelled_scans

scan = next(labelled_scans("corridor", 7, 1))
xyz_m, ring, times = scan.xyz_lidar_m, scan.ring, scan.offset_ns
view = np.ndarray((len(xyz_m), 3), np.float32, np.zeros((len(xyz_m), 22), np.uint8), 0, (22, 4))
view.flags.writeable = False
clouds = [(xyz_m, ring, times), (view, ring), (xyz_m.astype(np.float64),), (np.ascontiguousarray(xyz_m[::7] + 0.3),)]
clouds.append([np.concatenate([each, each[::5]]) for each in (xyz_m, ring, times)])
window, ground = window_around(np.zeros(2), 0.1, 200), GroundHeight(0.2)
lattices = [each(0.1, LogOddsMemory.LAYERS) for each in (SlidingLattice, GrowingLattice)]
memories, classifier = [LogOddsMemory(each, 0.4) for each in lattices], ScanClassifier(RangeImageSettings())
for k, cloud in enumerate(clouds):
    found = classifier.classify(PointCloud(0, "", *cloud), scan.transform_lidar_to_base)
    poses = np.zeros((len(found.slot_ns), 3))
    placed = place_scan(found, poses, window, np.zeros(2), PlacingSettings(min_points=2))
    ground.add(found, poses, 15.0)
    for memory in memories:
        memory.add(k, window, placed)
modules = [vars(each) for name, each in sys.modules.items() if name.startswith(("quadlog.lidar", "quadlog.mapping"))]
kernels = {each for module in modules for each in module.values() if isinstance(each, CPUDispatcher)}
print({each.py_func.__qualname__: each.signatures for each in kernels if len(each.signatures) > 1} or "one each")
"""


def test_every_kernel_is_compiled_for_one_kind_of_arguments() -> None:
    made = subprocess.run([sys.executable, "-c", _SCANS], capture_output=True, text=True, timeout=600, check=False)
    assert made.stderr == ""
    assert made.stdout == "one each\n"
