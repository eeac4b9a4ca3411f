"""Open3D, imported where it is used: it takes 1.8 s."""

from __future__ import annotations

import ctypes
import importlib.util
from types import ModuleType


def import_open3d() -> ModuleType:
    """The open3d module. The Linux x86-64 wheel is linked against libusb, which the libusb-package wheel carries."""
    if importlib.util.find_spec("libusb_package") is not None:
        import libusb_package

        # Global, so that the dynamic linker finds its symbols when it resolves open3d's own libraries.
        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    import open3d

    return open3d
