"""`quadlog --version`: quadlog's version, and those of what its results depend on; none of it is imported."""

from __future__ import annotations

import platform

import click

from quadlog.text import printable
from quadlog.version import __version__


def print_versions(ctx: click.Context, _param: click.Parameter, asked: bool) -> None:
    """A line for quadlog, for Python, for every package and for every plug-in; then the command ends."""
    if not asked or ctx.resilient_parsing:
        return
    from quadlog.plugins import all_plugins
    from quadlog.results.host import package_versions

    click.echo(f"quadlog, version {__version__}")
    versions = {"python": platform.python_version(), **package_versions()}
    width = max(map(len, versions))
    for name, version in versions.items():
        click.echo(f"{name:<{width}}  {version}")
    for each in all_plugins():
        click.echo(printable(f"{each.kind} {each.name}: {each.distribution} {each.version}"))
    ctx.exit()
