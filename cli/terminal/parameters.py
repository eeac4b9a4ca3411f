"""Arguments and options that commands share, and what a shell completes for them. Importing this is cheap.

The completion scripts are click's own: `eval "$(_QUADLOG_COMPLETE=bash_source quadlog)"`, likewise for zsh and fish.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click
from click.shell_completion import CompletionItem

from quadlog.config.planners import PLANNER_NAMES
from quadlog.errors import UsageError, printable
from quadlog.results.stages import STAGES
from quadlog.storage.remote_path import to_path
from quadlog.storage.urls import is_url

if TYPE_CHECKING:
    from quadlog.pipelines.request import Existing


def examples(*commands: str) -> str:
    """The end of a command's help."""
    return "\n".join(["\b", "Examples:", *(f"  {command}" for command in commands)])


Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def words(*choices: str) -> Complete:
    """Completes these words."""
    return lambda _ctx, _param, typed: [CompletionItem(each) for each in choices if each.startswith(typed)]


def files(*choices: str) -> Complete:
    """Completes names of files and folders, and these words."""
    return lambda ctx, param, typed: [*words(*choices)(ctx, param, typed), CompletionItem(typed, type="file")]


def all_planners() -> tuple[str, ...]:
    """Names of quadlog's own planners, then those of plug-ins."""
    from quadlog.config.plugins import PLANNERS, plugin_names

    return tuple(dict.fromkeys((*PLANNER_NAMES, *plugin_names(PLANNERS))))


class PlannerName(click.Choice[str]):
    """A planner of quadlog or of a plug-in; plug-ins are searched only for names that quadlog does not have."""

    def __init__(self) -> None:
        super().__init__(PLANNER_NAMES)

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """The name. Fails with the names of all planners."""
        return value if value in PLANNER_NAMES else click.Choice(all_planners()).convert(value, param, ctx)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Planners of quadlog and of plug-ins."""
        return words(*all_planners())(ctx, param, incomplete)


class PathType(click.Path):
    """A path that is opened later, so that a file that cannot be read is an error of exit code 1, not of usage."""

    def __init__(self, urls: bool) -> None:
        """urls: whether a URL is allowed, which becomes a RemotePath."""
        super().__init__(path_type=Path, readable=False)
        self._urls = urls

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Fails for a URL where none is allowed, and for an empty text, as an unset shell variable gives it."""
        if value == "":
            self.fail("the path is empty", param, ctx)
        if not is_url(value):
            return cast(Path, super().convert(value, param, ctx))
        if not self._urls:
            self.fail("a local path is required here, not a URL", param, ctx)
        return to_path(value)


PATH_OR_URL = PathType(urls=True)
LOCAL_PATH = PathType(urls=False)

FORMATS = ("table", "json", "csv", "markdown", "latex")
FORMAT = click.option(
    "--format",
    "to",
    type=click.Choice(FORMATS),
    default="table",
    metavar="FORMAT",
    help=f"Output format: {', '.join(FORMATS)}.",
)
AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
CONFIG = click.option("-c", "--config", "config_path", type=LOCAL_PATH, help="Configuration file (quadlog.toml).")
MSG_PATH = click.option(
    "--msg-path", type=LOCAL_PATH, multiple=True, help="Folder with more .msg definitions; repeatable."
)
FORCE = click.option("--force", is_flag=True, help="Replace existing results.")
START = click.option("--start", "start_s", type=click.FloatRange(min=0), metavar="S", help="Skip the first S seconds.")
DURATION = click.option(
    "--duration", "duration_s", type=click.FloatRange(min=0, min_open=True), metavar="S", help="Replay S seconds."
)
PRESET = click.option(
    "--preset",
    type=click.Choice(["paper"]),
    help="Methods and parameters of the papers; overrides the config file.",
)
UNTIL = click.option(
    "--until",
    type=click.Choice(STAGES),
    default="report",
    metavar="STAGE",
    help=f"Last stage to run: {', '.join(STAGES)}.",
)
SCHEDULER = click.option(
    "--scheduler", metavar="ADDRESS", help="Address of a running Dask scheduler (tcp://host:8786)."
)
RESUME = click.option("--resume", is_flag=True, help="Keep finished runs and complete the others.")
STAMP = click.option(
    "--stamp",
    type=click.Choice(["header", "log"]),
    default="header",
    help="Timestamps to use: message header or log time.",
)
MOST_SEEDS = 1000


def set_option(example: str) -> Callable[[Any], Any]:
    """The option --set."""
    text = f"Set a configuration key ({example}); repeatable."
    return click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help=text)


def seed_option(text: str = "Random seed.") -> Callable[[Any], Any]:
    """The option --seed, in the range that numpy's generators take."""
    return click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, metavar="N", help=text)


def seeds_option(text: str) -> Callable[[Any], Any]:
    """The option --seeds: the number of seeds from --seed on."""
    return click.option("--seeds", type=click.IntRange(1, MOST_SEEDS), default=1, metavar="N", help=text)


def jobs_option(what: str) -> Callable[[Any], Any]:
    """The option --jobs."""
    text = f"{what} in parallel. Default: number of cores."
    return click.option("--jobs", type=click.IntRange(min=1), metavar="N", help=text)


def controller_option(*choices: str) -> Callable[[Any], Any]:
    """The option --controller."""
    text = f"Controller: {', '.join(choices)}."
    return click.option("--controller", type=click.Choice(choices), metavar="NAME", help=text)


def what_exists(resume: bool, force: bool, scheduler: str | None, jobs: int | None) -> Existing:
    """What happens to existing runs. Raises UsageError for options that exclude each other."""
    from quadlog.pipelines.request import Existing

    if resume and force:
        raise UsageError("--resume and --force exclude each other")
    if scheduler and jobs:
        raise UsageError("--scheduler and --jobs exclude each other: the cluster sets the number of workers")
    return Existing.RESUME if resume else Existing.FORCE if force else Existing.REFUSE


def report_skipped(runs: Sequence[Path]) -> None:
    """Name on stderr the plain files among the arguments that lie beside run folders, as `runs/*` gives them."""
    from quadlog.results.find_runs import files_beside_runs

    if skipped := files_beside_runs(runs):
        click.echo(printable(f"skipped, not a run folder: {', '.join(map(str, skipped))}"), err=True)
