"""Arguments and options that commands share, and what a shell completes for them. Importing this is cheap.

The completion scripts are click's own: `eval "$(_QUADLOG_COMPLETE=bash_source quadlog)"`, likewise for zsh and fish.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial, reduce
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click
from click.shell_completion import CompletionItem

from quadlog.cli.progress import say
from quadlog.errors import UsageError
from quadlog.planning.planners import PLANNER_NAMES
from quadlog.results import STAGES
from quadlog.storage.urls import is_url

if TYPE_CHECKING:
    from quadlog.config.file import Configured
    from quadlog.pipelines.request import Existing

Decorator = Callable[[Any], Any]
Complete = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def examples(*lines: str) -> str:
    """The end of a help text."""
    return "\n".join(["\b", "Examples:", *(f"  quadlog {line}" for line in lines)])


def command(name: str, *arguments: str, **settings: Any) -> Callable[[Callable[..., Any]], click.Command]:
    """A command whose help ends with examples of its arguments."""
    return click.command(name, epilog=examples(*(f"{name} {each}" for each in arguments)), **settings)


def words(found: Callable[[], Iterable[str]]) -> Complete:
    """Completes these words."""
    return lambda _ctx, _param, typed: [CompletionItem(word) for word in found() if word.startswith(typed)]


def files(*also: str) -> Complete:
    """Completes names of files and folders, and these words."""
    return lambda *typed: [*words(lambda: also)(*typed), CompletionItem(typed[-1], type="file")]


config_keys = words(lambda: [f"{key}=" for key in import_module("quadlog.config.file").all_keys()])
metrics = words(lambda: import_module("quadlog.metrics.catalogue").CATALOGUE)


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
        from quadlog.storage.remote_path import to_path  # which help and completion do without

        return to_path(value)


def named(*names: str, choices: Iterable[str], what: str, metavar: str = "NAME", **settings: Any) -> Decorator:
    """An option whose choices are listed in its help."""
    text = f"{what}: {', '.join(choices)}."
    return click.option(*names, type=click.Choice([*choices]), metavar=metavar, help=text, **settings)


PATH_OR_URL = PathType(urls=True)
LOCAL_PATH = PathType(urls=False)
FORMATS = ("table", "json", "csv", "markdown", "latex")
MOST_SEEDS = 1000

FORMAT = named("--format", "to", choices=FORMATS, what="Output", metavar="FORMAT", default="table")
AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON.")
CONFIG = click.option("-c", "--config", "config_path", type=LOCAL_PATH, help="Configuration file (quadlog.toml).")
FORCE = click.option("--force", is_flag=True, help="Replace existing results.")
NO_PLOTS = click.option("--no-plots", is_flag=True, help="Write no pictures to plots/.")
STAMPS, STAMP_HELP = click.Choice(["auto", "header", "log"]), "Header stamps or log times; auto: stamps on one clock."
STAMP = click.option("--stamp", type=STAMPS, default="auto", help=STAMP_HELP)
SEED = click.option("--seed", type=click.IntRange(0, 2**32 - 1), default=0, metavar="N", help="First random seed.")
SEEDS = click.option("--seeds", type=click.IntRange(1, MOST_SEEDS), default=1, metavar="N", help="Number of seeds.")
JOBS = click.option("--jobs", type=click.IntRange(1), metavar="N", help="Processes. Default: the number of cores.")


def repeated(*names: str, help: str, **settings: Any) -> Decorator:  # noqa: A002 - as click calls it
    """An option that may be given several times."""
    return click.option(*names, multiple=True, help=f"{help}; repeatable.", **settings)


MSG_PATH = repeated("--msg-path", type=LOCAL_PATH, help="Folder with more .msg definitions")


def set_option(example: str) -> Decorator:
    """The option --set."""
    how: dict[str, Any] = {"metavar": "KEY=VALUE", "shell_complete": config_keys}
    return repeated("--set", "overrides", help=f"Set a configuration key ({example})", **how)


def output_option(text: str, default: str | None = None, **settings: Any) -> Decorator:
    """The option --output, a local path unless settings say otherwise."""
    place = None if default is None else Path(default)
    return click.option("-o", "--output", default=place, help=text, **{"type": LOCAL_PATH, **settings})


def plugged_option(*names: str, own: Sequence[str], group: str, help: str, **settings: Any) -> Decorator:  # noqa: A002
    """An option that takes a name of quadlog's own or of a plug-in; plug-ins are searched only for other names."""

    def every() -> tuple[str, ...]:
        from quadlog.plugins import plugin_names

        return tuple(dict.fromkeys((*own, *plugin_names(group))))

    def name(text: str) -> str:
        return text if text in own else click.Choice(every()).convert(text, None, None)

    how: dict[str, Any] = {"type": name, "metavar": "NAME", "shell_complete": words(every)}
    return click.option(*names, help=help, **how, **settings)


planner_option = partial(plugged_option, own=PLANNER_NAMES, group="quadlog.planners")


def controller_option(own: Sequence[str]) -> Decorator:
    """The option --controller, with quadlog's own in its help."""
    text = f"Controller: {', '.join(own)}, or a plug-in."
    return plugged_option("--controller", own=own, group="quadlog.controllers", help=text)


def replay_options(function: Callable[..., Any]) -> Callable[..., Any]:
    """The options that `replay` and `sweep` share."""
    positive, papers = click.FloatRange(min=0, min_open=True), "Methods and parameters of the papers."
    shared = (
        click.option("--start", "start_s", type=click.FloatRange(min=0), metavar="S", help="Skip the first S seconds."),
        click.option("--duration", "duration_s", type=positive, metavar="S", help="Replay S seconds."),
        click.option("--preset", type=click.Choice(["paper"]), help=papers),
        named("--until", choices=STAGES, what="Last stage", metavar="STAGE", default="report"),
        JOBS,
        click.option("--scheduler", metavar="ADDRESS", help="Dask scheduler (tcp://host:8786)."),
        click.option("--resume", is_flag=True, help="Keep finished runs and complete the others."),
        *(FORCE, STAMP, MSG_PATH, AS_JSON),
    )
    return reduce(lambda done, option: option(done), reversed(shared), function)


def how_to_run(given: dict[str, Any]) -> tuple[Existing, int | None, str | None]:
    """Takes out of `given` what happens to existing runs, the number of jobs, and the scheduler; None: not given.

    Raises UsageError for options that exclude each other.
    """
    from quadlog.pipelines.request import Existing

    resume, force, jobs, scheduler = map(given.pop, ("resume", "force", "jobs", "scheduler"))
    if resume and force:
        raise UsageError("--resume and --force exclude each other")
    if scheduler and jobs:
        raise UsageError("--scheduler and --jobs exclude each other: the cluster sets the number of workers")
    return Existing.RESUME if resume else Existing.FORCE if force else Existing.REFUSE, jobs, scheduler


def configured(given: dict[str, Any], **keys: str) -> Configured:
    """Takes the configuration out of `given`: -c, --set, --preset, and the options that set single keys."""
    from quadlog.config.file import Flag, configure

    path, overrides, preset = given.pop("config_path"), given.pop("overrides"), given.pop("preset", None)
    flags = [Flag(f"--{name}", key, given.pop(name)) for name, key in keys.items()]
    found = configure(path, overrides, preset=preset, flags=flags)
    for note in found.notes:
        say(note)
    return found
