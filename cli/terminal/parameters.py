"""Kinds of arguments and what a shell completes for them; nothing heavy is imported for it.

The scripts are click's own: `eval "$(_QUADLOG_COMPLETE=bash_source quadlog)"`, and the same with zsh and fish.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, cast

import click
from click.shell_completion import CompletionItem

from quadlog.config.planners import PLANNER_NAMES
from quadlog.errors import printable
from quadlog.storage.remote_path import to_path
from quadlog.storage.urls import is_url


def examples(*commands: str) -> str:
    """What a command's help ends with."""
    return "\n".join(["\b", "Examples:", *(f"  {command}" for command in commands)])


SEED = click.IntRange(0, 2**32 - 1)
"""What numpy and every other generator take."""

Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def words(*choices: str) -> Complete:
    """Of these words those that go on with what is typed."""
    return lambda _ctx, _param, typed: [CompletionItem(each) for each in choices if each.startswith(typed)]


def files(*choices: str) -> Complete:
    """Files and folders, and of these words those that go on with what is typed."""
    return lambda ctx, param, typed: [*words(*choices)(ctx, param, typed), CompletionItem(typed, type="file")]


def planners(ctx: click.Context, param: click.Parameter, typed: str) -> list[CompletionItem]:
    """Planners of quadlog and of plug-ins."""
    return words(*all_planners())(ctx, param, typed)


def all_planners() -> tuple[str, ...]:
    """Names of quadlog's own planners, then those of plug-ins."""
    from quadlog.config.plugins import PLANNERS, plugin_names

    return tuple(dict.fromkeys((*PLANNER_NAMES, *plugin_names(PLANNERS))))


class PlannerName(click.Choice[str]):
    """One of quadlog's own planners, or of a plug-in's, which are looked for when the name is none of quadlog's."""

    def __init__(self) -> None:
        super().__init__(PLANNER_NAMES)

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The name. Fails with all there are."""
        return value if value in PLANNER_NAMES else click.Choice(all_planners()).convert(value, param, ctx)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Both kinds."""
        return planners(ctx, param, incomplete)


class PathOrUrlType(click.Path):
    """A path, or a URL, which becomes a RemotePath."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """See to_path. Fails for an empty text."""
        _refuse_nothing(self, value, param, ctx)
        return to_path(value) if is_url(value) else cast(Path, super().convert(value, param, ctx))


class LocalPathType(click.Path):
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
PLACE = PathOrUrlType(path_type=Path, readable=False)
HERE = LocalPathType(path_type=Path, readable=False)


def say_skipped(runs: Sequence[Path]) -> None:
    """A line on stderr that names the files which `runs/*` gave beside the run folders."""
    from quadlog.results.run.find_runs import files_beside_runs

    if skipped := files_beside_runs(runs):
        click.echo(printable(f"skipped, not a run folder: {', '.join(map(str, skipped))}"), err=True)
