"""What other distributions add to quadlog: found among the entry points, and imported only when it is used.

A distribution names what it adds in its pyproject.toml:

    [project.entry-points."quadlog.planners"]
    greedy = "my_package.greedy:Greedy"                 # a class: quadlog.planning.protocol.Planner
    [project.entry-points."quadlog.decoders"]
    "my_msgs/msg/Report" = "my_package.report:decoder"  # an object: quadlog.recordings.plugged.MessageDecoder
    [project.entry-points."quadlog.controllers"]
    spring = "my_package.spring:Spring"                 # a class: quadlog.control.locomotion.plugged.Controller
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, redirect_stdout
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from typing import Any, NoReturn

from quadlog.errors import QuadlogError

PLANNERS = "quadlog.planners"
DECODERS = "quadlog.decoders"
CONTROLLERS = "quadlog.controllers"
KINDS = {PLANNERS: "planner", DECODERS: "decoder", CONTROLLERS: "controller"}


@dataclass(frozen=True, slots=True)
class Plugin:
    """An entry point, and the distribution that has it: one that is not imported yet."""

    group: str
    name: str
    distribution: str
    version: str
    entry_point: metadata.EntryPoint

    @property
    def kind(self) -> str:
        """`planner`, `decoder` or `controller`."""
        return KINDS[self.group]

    def load(self) -> Any:
        """The object it names. Raises QuadlogError where importing it fails, whatever the reason."""
        with foreign_code(lambda failure: self.unusable(f"cannot be loaded: {failure}")):
            return self.entry_point.load()

    def doing(self, task: str) -> AbstractContextManager[None]:
        """Run its code: what that raises becomes `unusable`, as `could not plan: ValueError: lost`."""
        return foreign_code(lambda failure: self.unusable(f"could not {task}: {failure}"))

    def unusable(self, reason: str) -> QuadlogError:
        """The error that says why it cannot be used."""
        why = " ".join(reason.split())
        return QuadlogError(f"{self.kind} {self.name} of {self.distribution} {self.version}: {why}")


@contextmanager
def foreign_code(error_of: Callable[[str], QuadlogError]) -> Iterator[None]:
    """What code of a plug-in raises becomes the error that is made of its description; so does an attempt to end the
    process. QuadlogErrors and interrupts by the user pass. What it prints goes to stderr: stdout is for results.
    """
    process, leave = os.getpid(), os._exit

    def refuse(status: int) -> NoReturn:
        if os.getpid() != process:  # a child that the plug-in forked
            leave(status)
        raise SystemExit(f"os._exit({status})")

    os._exit = refuse
    try:
        with redirect_stdout(sys.stderr):
            yield
    except (QuadlogError, KeyboardInterrupt):
        raise
    except BaseException as error:
        raise error_of(describe_failure(error)) from error
    finally:
        os._exit = leave


def describe_failure(error: BaseException) -> str:
    """Class and message of an exception that a plug-in raised; its own __str__ may raise too."""
    try:
        return f"{type(error).__name__}: {error}"
    except (Exception, SystemExit):
        return f"{type(error).__name__}: without a readable message"


def plugin_names(group: str) -> tuple[str, ...]:
    """The names in a group, sorted; nothing is imported."""
    return tuple(sorted(_installed(group)))


def all_plugins() -> list[Plugin]:
    """Every plug-in, by group and name; also those whose name is taken."""
    return [each for group in KINDS for name in plugin_names(group) for each in _installed(group)[name]]


def find_plugin(group: str, name: str, *, taken: bool) -> Plugin | None:
    """The plug-in of a name, None where there is none. taken: whether quadlog has that name itself.

    Raises QuadlogError where quadlog or another distribution has the name as well.
    """
    found = _installed(group).get(name, ())
    if not found:
        return None
    if taken or len(found) > 1:
        owners = ["quadlog"] * taken + [f"{each.distribution} {each.version}" for each in found]
        several = f"several have that name ({', '.join(owners)})"
        raise QuadlogError(f"{KINDS[group]} {name}: {several}; rename one, or uninstall what adds it")
    return found[0]


LONGEST_NAME = 200
SAVED = "saved"
"""The context in which the configuration of a run is read, which may have been made with plug-ins that are not here."""


def known_name(name: str, info: Any, *, group: str, own: Iterable[str]) -> str:
    """The name, if quadlog or a plug-in has it; plug-ins are looked for only where none of quadlog's own has.

    info: pydantic's. Raises ValueError, which lists all there are.
    """
    may_be_gone = info.context == SAVED and len(name) <= LONGEST_NAME and name.isprintable()
    if not may_be_gone and name not in own and name not in (others := plugin_names(group)):
        names = ", ".join(dict.fromkeys((*own, *others)))
        raise ValueError(f"there is no such {KINDS[group]}; choose one of: {names}")
    return name


@cache
def _installed(group: str) -> dict[str, tuple[Plugin, ...]]:
    """Name -> the plug-ins of that name; more than one where distributions collide."""
    found: dict[str, tuple[Plugin, ...]] = {}
    for each in metadata.entry_points(group=group):
        found[each.name] = (*found.get(each.name, ()), Plugin(group, each.name, *_owner(each), each))
    return found


def _owner(entry_point: metadata.EntryPoint) -> tuple[str, str]:
    """Name and version of the distribution, as far as its metadata tell: some installers leave none."""
    try:
        about: Any = entry_point.dist.metadata if entry_point.dist else None
    except FileNotFoundError:  # from the backport, which answers instead of the standard library once it is imported
        about = None
    known = {} if about is None else {"name": about.get("Name"), "version": about.get("Version")}
    return known.get("name") or "an unnamed distribution", known.get("version") or "?"
