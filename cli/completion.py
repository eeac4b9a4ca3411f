"""What a shell offers where click cannot tell by itself; nothing heavy is imported for it.

The scripts are click's own: `eval "$(_QUADLOG_COMPLETE=bash_source quadlog)"`, and the same with zsh and fish.
"""

from __future__ import annotations

from collections.abc import Callable

import click
from click.shell_completion import CompletionItem

from quadlog.planning.names import PLANNER_NAMES

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
    from quadlog.plugins import PLANNERS, plugin_names

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
