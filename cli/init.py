"""`quadlog init`: a first quadlog.toml for a recording."""

from __future__ import annotations

from pathlib import Path

import click

from quadlog.errors import AlreadyExists


@click.command(name="init")
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "-o", "--output", type=click.Path(path_type=Path), default=Path("quadlog.toml"), help="Where it is written."
)
@click.option("--msg-path", type=click.Path(path_type=Path), multiple=True, help="Folder of further .msg definitions.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
def command(recording: Path, output: Path, msg_path: tuple[Path, ...], force: bool) -> int:
    """Write a commented config with what was detected in the recording filled in."""
    if output.exists() and not force:
        raise AlreadyExists(output)  # before the recording is read, which may take a while

    from quadlog.pipelines.init import propose_config, write_new

    write_new(output, propose_config(recording, msg_path), force=force)
    click.echo(str(output))
    return 0
