"""What measures the tables, as one digest: quadlog's own source, the packages under it, and the machine's kind."""

from __future__ import annotations

import hashlib
import json
import platform
from pathlib import Path

import quadlog
from quadlog import pipelines
from quadlog.results.host import package_versions

ONLY_PRINTS = "quadlog/cli/"


def code_digest() -> str:
    """SHA-256 over every source file but the command line's, and over the versions of what they call.

    It changes more often than the numbers do: no change of a number is ever missed.
    """
    sources = {
        f"{top}/{path.relative_to(root).as_posix()}": hashlib.sha256(path.read_bytes()).hexdigest()
        for top, root in _roots()
        for path in root.rglob("*.py")
    }
    judged = {name: digest for name, digest in sources.items() if not name.startswith(ONLY_PRINTS)}
    # Compiled code may round otherwise on another kind of machine.
    machine = [platform.python_version(), platform.system(), platform.machine()]
    everything = {"sources": judged, "packages": package_versions(), "machine": machine}
    return hashlib.sha256(json.dumps(everything, sort_keys=True).encode()).hexdigest()


def _roots() -> list[tuple[str, Path]]:
    """The pipelines lie beside quadlog in a checkout, and inside it once installed; they have one name in both."""
    return [(package.__name__.replace(".", "/"), Path(package.__path__[0])) for package in (quadlog, pipelines)]
