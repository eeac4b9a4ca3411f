"""quadlog: replay what a quadruped logged through every algorithm worth comparing."""

from quadlog.version import __version__

__all__ = ["__version__"]
