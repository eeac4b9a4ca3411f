"""Every specialisation of a compiled function costs the first start a share of a second."""

from __future__ import annotations

import subprocess
import sys

_SCANS = """
import sys
import numpy as np
from numba.core.registry import CPUDispatcher
from quadlog.lidar.scan_classifier import RangeImageSettings, ScanClassifier
from quadlog.mapping.grid import GrowingLattice, SlidingLattice
from quadlog.mapping.memory import AccumulatedMap, GroundHeight, LogOddsMemory
from quadlog.mapping.placing import PlacingSettings, place_scan
from quadlog.mapping.grid import window_around
from quadlog.messages import PointCloud
from quadlog.simulation.synthetic.labelled_scans import labelled_scans

scan = next(labelled_scans("corridor", 7, 1))
xyz_m, ring, times = scan.xyz_lidar_m, scan.ring, scan.offset_ns
twice = np.concatenate([xyz_m, xyz_m[::5] / 2]), np.concatenate([ring, ring[::5]]), np.concatenate([times, times[::5]])
payload = np.zeros((len(xyz_m), 22), np.uint8)
view = np.ndarray((len(xyz_m), 3), np.float32, payload, 0, (22, 4))
view[:] = xyz_m
view.flags.writeable = False
clouds = [
    PointCloud(0, "", xyz_m, ring, times), PointCloud(0, "", *twice), PointCloud(0, "", view, ring),
    PointCloud(0, "", xyz_m.astype(np.float64)), PointCloud(0, "", np.ascontiguousarray(xyz_m[::7] + 0.3)),
]
for view_deg in (360.0, 180.0):
    classifier = ScanClassifier(RangeImageSettings(field_of_view_deg=view_deg))
    for lattice in (SlidingLattice, GrowingLattice):
        memory = LogOddsMemory(lattice(0.1, LogOddsMemory.LAYERS), 0.4)
        whole, ground = AccumulatedMap(0.1), GroundHeight(0.2)
        for k, cloud in enumerate(clouds):
            returns = classifier.classify(cloud, scan.transform_lidar_to_base)
            window = window_around(np.zeros(2), 0.1, 200)
            poses = np.zeros((len(returns.slot_ns), 3))
            placed = place_scan(returns, poses, window, np.zeros(2), PlacingSettings(min_points=2))
            memory.add(k, window, placed)
            whole.add(window, placed, 400)
            ground.add(returns, poses, 15.0)
seen = {}
for name, module in list(sys.modules.items()):
    if name.startswith(("quadlog.lidar", "quadlog.mapping")):
        for each in vars(module).values():
            if isinstance(each, CPUDispatcher) and len(each.overloads) > 1:
                seen[each.py_func.__qualname__] = [str(signature) for signature in each.overloads]
print(seen or "one each")
"""


def test_every_kernel_is_compiled_for_one_kind_of_arguments() -> None:
    made = subprocess.run([sys.executable, "-c", _SCANS], capture_output=True, text=True, timeout=600, check=False)
    assert made.stderr == ""
    assert made.stdout == "one each\n"
