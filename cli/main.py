"""The `quadlog` command: imports subcommands when needed, turns errors into one line and an exit code."""

from __future__ import annotations

import importlib
import os
import sys
from pathlib import Path
from typing import Any

import click

from quadlog.cli.options import examples
from quadlog.cli.progress import say
from quadlog.errors import CannotWrite, ExitCode, Interrupted, QuadlogError, clipped, nearest, printable
from quadlog.pipelines.executor.machine import ignore_interrupts, is_out_of_memory, take_one_interrupt
from quadlog.storage.urls import is_url
from quadlog.version import __version__

VERSIONS = "Show the versions of quadlog, packages and plug-ins, and exit."


def print_versions(ctx: click.Context, _param: click.Parameter, asked: bool) -> None:
    """Print the versions of quadlog, packages and plug-ins, and exit."""
    if not asked or ctx.resilient_parsing:
        return
    from quadlog.config.version import package_versions
    from quadlog.plugins import all_plugins

    click.echo(f"quadlog, version {__version__}")
    versions = {"python": sys.version.split()[0], **package_versions()}
    for name, version in versions.items():
        click.echo(f"{name:{max(map(len, versions))}}  {version}")
    for each in all_plugins():
        click.echo(printable(f"{each.kind} {each.name}: {each.distribution} {each.version}"))
    ctx.exit()


COMMANDS = (
    *("info", "init", "replay", "sweep", "survey", "compare-planners", "simulate"),
    *("metrics", "report", "export", "diff", "check", "synthesize", "tables"),
)

_MAX_MESSAGE = 8000


class LazyGroup(click.Group):
    """A group with one file per command, imported when it is named, so that help is fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """All commands, in the order of the help."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """The command of cli/NAME.py, None for an unknown name."""
        if name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"quadlog.cli.{name.replace('-', '_')}").command
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> Any:
        """As click does, with the command that was most likely meant."""
        try:
            return super().resolve_command(ctx, args)
        except click.UsageError as error:
            meant = nearest(args[0], COMMANDS)
            raise (click.UsageError(f"{error.message} Did you mean {meant}?", ctx) if meant else error) from None

    def invoke(self, ctx: click.Context) -> object:
        """Run the command. Raises Interrupted in place of a KeyboardInterrupt, for which click prints an empty line."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise Interrupted(*error.args) from error


@click.group(
    cls=LazyGroup,
    epilog=examples("info walk.mcap", "replay walk.mcap -c quadlog.toml", "metrics runs/walk --explain ate_rmse_m"),
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110, "show_default": True},
)
@click.option("--version", is_flag=True, is_eager=True, expose_value=False, callback=print_versions, help=VERSIONS)
def cli() -> None:
    """Replay recordings of a quadruped robot through positioning, mapping, planning and control.

    Results go to stdout, messages to stderr. Exit codes: 0 done, 1 failed, 2 usage, 3 done with loss, 4 a check failed.
    """


def main() -> None:
    """Entry point: a known error is one line on stderr; a traceback is a bug in quadlog."""
    # MuJoCo looks for OpenGL when it is imported, and fails without it; code that renders chooses it itself.
    os.environ["MUJOCO_GL"] = "disable"
    _open_closed_streams()
    take_one_interrupt()
    exit_code = run(sys.argv[1:])
    ignore_interrupts()
    sys.exit(exit_code)


def _open_closed_streams() -> None:
    """Standard streams that the shell closed (>&-) lead nowhere, and no file gets their numbers."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, os.fdopen(os.open(os.devnull, os.O_RDWR), mode))


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    try:
        exit_code = cli.main(arguments, prog_name="quadlog", standalone_mode=False)
        sys.stdout.flush()
        return exit_code or 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (Interrupted, KeyboardInterrupt, click.Abort) as error:
        say(f"quadlog: {_interrupted_words(error, arguments)}")
        return ExitCode.FAILED
    except QuadlogError as error:
        say(f"quadlog: {clipped(error, _MAX_MESSAGE)}{_meant(error)}")
        return error.exit_code
    except BrokenPipeError:
        # The reader of stdout (head, less) has gone: redirect stdout, so that the interpreter exits without an error.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.FAILED
    except OSError as error:
        # A full disk or a missing permission, which the user can fix.
        say(f"quadlog: {f'{error.filename}: ' if error.filename else ''}{error.strerror or error}")
        return ExitCode.FAILED
    except Exception as error:
        if not is_out_of_memory(error):
            raise
        say(f"quadlog: out of memory{f' ({clipped(error)})' if str(error) else ''}")
        return ExitCode.FAILED


def _meant(error: QuadlogError) -> str:
    """The path beside a missing one that was most likely meant."""
    path = getattr(error, "path", None)
    if path is None or isinstance(error, CannotWrite) or is_url(str(path)):
        return ""
    place = Path(path)
    beside = [] if place.exists() or not place.parent.is_dir() else [entry.name for entry in place.parent.iterdir()]
    meant = nearest(place.name, beside)
    return printable(f"; did you mean {place.with_name(meant)}?") if meant else ""


def _interrupted_words(error: BaseException, arguments: list[str]) -> str:
    """The signal that interrupted a command, once nothing unfinished is left of it."""
    from quadlog.storage.atomic_write import remove_unfinished

    remove_unfinished()
    words = str(error) if isinstance(error, Interrupted) else str(Interrupted(*error.args))
    goes_on = ", and --resume goes on" if arguments[:1] in (["replay"], ["sweep"]) else ""
    return f"{words}; nothing half-written was left{goes_on}"
