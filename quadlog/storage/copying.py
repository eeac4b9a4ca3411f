"""What lies behind a URL, copied to this machine: formats that cannot be read by range, and runs."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from quadlog.errors import StorageFailed, TooLarge
from quadlog.storage.remote_object import RemoteObject
from quadlog.storage.urls import redacted


def copy_object(remote: RemoteObject, target: Path) -> None:
    """All bytes of an object into a new file.

    Raises TooLarge where it would fill more than half of the disk's free room, StorageFailed, StorageChanged.
    """
    told, shown = remote.told.size_bytes, redacted(remote.url)
    # Half of what is free: the rest of the machine lives there too.
    room = shutil.disk_usage(target.parent).free // 2
    if told is not None and told > room:
        raise TooLarge(f"{shown}: bytes to copy to {target.parent}", told, room)
    written = 0
    with target.open("xb") as file:
        for block in remote.stream():
            written += len(block)
            if written > room:
                raise TooLarge(f"{shown}: bytes to copy to {target.parent}", written, room)
            file.write(block)
    if told is not None and written != told:
        raise StorageFailed(shown, f"{written} bytes came where the server had told of {told}")


def copied(remote: RemoteObject, name: str) -> tempfile.TemporaryDirectory[str]:
    """A temporary folder with the object in it, under a name of this program's choice. Raises as copy_object."""
    folder = tempfile.TemporaryDirectory(prefix="quadlog-")
    try:
        copy_object(remote, Path(folder.name) / name)
    except BaseException:
        folder.cleanup()
        raise
    return folder
