"""The `quadlog` command: finds subcommands when they are asked for, turns errors into one line and an exit code."""

from __future__ import annotations

import importlib
import os
import platform
import sys
import time

import click

from quadlog.errors import ExitCode, Interrupted, QuadlogError, clipped, printable
from quadlog.pipelines.executor.machine import ignore_interrupts, is_out_of_memory, take_one_interrupt
from quadlog.version import __version__


def print_versions(ctx: click.Context, _param: click.Parameter, asked: bool) -> None:
    """A line for quadlog, for Python, for every package and for every plug-in; then the command ends."""
    if not asked or ctx.resilient_parsing:
        return
    from quadlog.config.plugins import all_plugins
    from quadlog.config.version import package_versions

    click.echo(f"quadlog, version {__version__}")
    versions = {"python": platform.python_version(), **package_versions()}
    width = max(map(len, versions))
    for name, version in versions.items():
        click.echo(f"{name:<{width}}  {version}")
    for each in all_plugins():
        click.echo(printable(f"{each.kind} {each.name}: {each.distribution} {each.version}"))
    ctx.exit()


COMMANDS = (
    *("info", "init", "replay", "compare-planners", "simulate"),
    *("metrics", "report", "export", "diff", "check", "synthesize", "tables"),
)

_MAX_MESSAGE = 8000


class LazyGroup(click.Group):
    """A group whose commands live one per file and are imported when named, so that help stays instant."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Every command, in the order a user meets them."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        """The command object of cli/<name>.py, None for an unknown name."""
        if name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"quadlog.cli.{name.replace('-', '_')}").command
        return command

    def invoke(self, ctx: click.Context) -> object:
        """Run the command. Raises Interrupted in place of a KeyboardInterrupt, for which click prints an empty line."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as error:
            raise Interrupted(*error.args) from error


@click.group(
    cls=LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110, "show_default": True},
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=print_versions,
    help="Show the versions of quadlog, of what it builds on and of its plug-ins.",
)
def cli() -> None:
    """Replay what a quadruped logged through every algorithm worth comparing.

    Results go to stdout, talk to stderr. Exit codes: 0 done, 1 failed, 2 usage, 3 done with loss, 4 a check failed.
    """


def main() -> None:
    """Entry point: a known error is one line on stderr, an unknown one a traceback, which is a bug in quadlog."""
    # MuJoCo looks for a way to draw when it is imported, and fails where there is none; who draws, chooses.
    os.environ["MUJOCO_GL"] = "disable"
    take_one_interrupt()
    exit_code = run(sys.argv[1:])
    ignore_interrupts()
    sys.exit(exit_code)


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit code."""
    started_s = time.monotonic()
    try:
        exit_code = cli.main(arguments, prog_name="quadlog", standalone_mode=False)
        sys.stdout.flush()
        return exit_code or 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (Interrupted, KeyboardInterrupt, click.Abort) as error:
        click.echo(f"quadlog: {printable(_interrupted_words(error, arguments, started_s))}", err=True)
        return ExitCode.FAILED
    except QuadlogError as error:
        click.echo(f"quadlog: {printable(clipped(error, _MAX_MESSAGE))}", err=True)
        return error.exit_code
    except BrokenPipeError:
        # The reader of stdout (head, less) has gone: point stdout elsewhere so that the interpreter's exit is quiet.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.FAILED
    except OSError as error:
        # A full disk, a folder without permission: a user's to mend. Anything else an OSError says just as well.
        where = f"{error.filename}: " if error.filename else ""
        click.echo(f"quadlog: {printable(where)}{error.strerror or error}", err=True)
        return ExitCode.FAILED
    except Exception as error:
        if not is_out_of_memory(error):
            raise
        details = f" ({printable(clipped(error))})" if str(error) else ""
        click.echo(f"quadlog: out of memory{details}", err=True)
        return ExitCode.FAILED


def _interrupted_words(error: BaseException, arguments: list[str], started_s: float) -> str:
    """By what a command was interrupted, and what is left of its work."""
    from quadlog.storage.atomic_write import complete_folders, remove_unfinished

    remove_unfinished()
    words = str(error) if isinstance(error, Interrupted) else str(Interrupted(*error.args))
    folders = complete_folders(started_s)
    if folders:
        others = f" and {len(folders) - 1} more" if len(folders) > 1 else ""
        return f"{words}; the result in {folders[-1]}{others} is complete"
    goes_on = ", and --resume goes on" if arguments[:1] == ["replay"] else ""
    return f"{words}; nothing half-written was left{goes_on}"
