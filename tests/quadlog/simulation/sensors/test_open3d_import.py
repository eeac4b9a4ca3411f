from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest


def test_open3d_comes_when_asked_and_not_before():
    program = (
        "import sys\n"
        "from quadlog.simulation.sensors.scene import import_open3d\n"
        "assert 'open3d' not in sys.modules\n"
        "print(import_open3d().t.geometry.RaycastingScene)\n"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert "RaycastingScene" in answer.stdout


@pytest.mark.skipif(importlib.util.find_spec("libusb_package") is None, reason="this platform's wheel needs no libusb")
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="no list of loaded libraries to look at")
def test_libusb_comes_from_its_wheel_whatever_the_machine_has():
    program = (
        "from quadlog.simulation.sensors.scene import import_open3d\nimport_open3d()\n"
        "assert 'libusb_package' in open('/proc/self/maps').read()\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True)
