"""`quadlog init`: a first quadlog.toml for a recording."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.cli import options
from quadlog.cli.info import report_health
from quadlog.errors import ExitCode


@options.command("init", "walk.mcap", "walk.mcap -o lab.toml --force")
@click.argument("recording", type=options.PATH_OR_URL)
@options.output_option("File to write.", "quadlog.toml")
@click.option("--all", "everything", is_flag=True, help="Write all sections, including unused ones.")
@options.MSG_PATH
@options.FORCE
def command(recording: Path, output: Path, everything: bool, msg_path: tuple[Path, ...], force: bool) -> int:
    """Write a commented configuration for a recording.

    Detected topics, tags and anchors are filled in. Keys that are commented out have their default values.
    """
    from quadlog.pipelines.info import propose_config, write_new
    from quadlog.results.find_runs import refuse_existing

    refuse_existing(output, force, [recording])  # before the recording is read, which may take a while
    proposal = propose_config(recording, msg_path, everything=everything)
    report_health(proposal.warnings, [(loss.topic, loss.detail) for loss in proposal.losses])
    write_new(output, proposal.text, force=force)
    click.echo(str(output))
    return ExitCode.WITH_LOSS if proposal.losses else ExitCode.DONE
