"""Arguments that name places: paths, and where that is said URLs."""

from __future__ import annotations

from pathlib import Path
from typing import Any, cast

import click

from quadlog.storage.urls import is_url, to_path


class Place(click.Path):
    """A path, or a URL, which becomes a RemotePath."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """See to_path."""
        return to_path(value) if is_url(value) else cast(Path, super().convert(value, param, ctx))


class Here(click.Path):
    """A path of this machine."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Fails for a URL, which would become a folder of a strange name."""
        if is_url(value):
            self.fail("a path of this machine is needed here, no URL", param, ctx)
        return cast(Path, super().convert(value, param, ctx))


# Not looked at here: what cannot be read is told in one line, not as wrong usage.
PLACE = Place(path_type=Path, readable=False)
HERE = Here(path_type=Path, readable=False)
