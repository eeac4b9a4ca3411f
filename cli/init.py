"""`quadlog init`: a first quadlog.toml for a recording."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli.info import tell_health
from quadlog.cli.terminal.parameters import HERE, PLACE, examples
from quadlog.errors import AlreadyExists, ExitCode


@click.command(
    name="init",
    short_help="A commented config with what was detected filled in.",
    epilog=examples(
        "quadlog init walk.mcap",
        "quadlog init walk.mcap -o lab.toml --force",
    ),
)
@click.argument("recording", type=PLACE)
@click.option("-o", "--output", type=HERE, default=Path("quadlog.toml"), help="Where it is written.")
@click.option("--msg-path", type=HERE, multiple=True, help="Folder of further .msg definitions.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
def command(recording: Path, output: Path, msg_path: tuple[Path, ...], force: bool) -> int:
    """Write a commented config with what was detected in the recording filled in."""
    if output.exists() and not force:
        raise AlreadyExists(output)  # before the recording is read, which may take a while

    from quadlog.pipelines.init import propose_config, write_new

    proposal = propose_config(recording, msg_path)
    tell_health(proposal.warnings, [(loss.topic, loss.detail) for loss in proposal.losses])
    write_new(output, proposal.text, force=force)
    click.echo(str(output))
    return ExitCode.WITH_LOSS if proposal.losses else ExitCode.DONE
