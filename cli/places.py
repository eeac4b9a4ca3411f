"""Arguments that name places: paths, and where that is said URLs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import click

from quadlog.storage.urls import is_url, to_path
from quadlog.text import printable


class Place(click.Path):
    """A path, or a URL, which becomes a RemotePath."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """See to_path. Fails for an empty text."""
        _refuse_nothing(self, value, param, ctx)
        return to_path(value) if is_url(value) else cast(Path, super().convert(value, param, ctx))


class Here(click.Path):
    """A path of this machine."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Fails for a URL, which would become a folder of a strange name, and for an empty text."""
        _refuse_nothing(self, value, param, ctx)
        if is_url(value):
            self.fail("a path of this machine is needed here, no URL", param, ctx)
        return cast(Path, super().convert(value, param, ctx))


def _refuse_nothing(kind: click.Path, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> None:
    """A shell's variable that is not set would stand for the current folder."""
    if value == "":
        kind.fail("an empty text names no place", param, ctx)


# Not looked at here: what cannot be read is told in one line, not as wrong usage.
PLACE = Place(path_type=Path, readable=False)
HERE = Here(path_type=Path, readable=False)


def say_skipped(runs: Sequence[Path]) -> None:
    """A line on stderr that names the files which `runs/*` gave beside the run folders."""
    from quadlog.results.find_runs import files_beside_runs

    if skipped := files_beside_runs(runs):
        click.echo(printable(f"skipped, not a run folder: {', '.join(map(str, skipped))}"), err=True)
