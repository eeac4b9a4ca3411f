"""YAML as recorders and map servers write it: mappings, lists and text; what makes a small file large is refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from pydantic import BaseModel, ValidationError

from quadlog.errors import clipped

Model = TypeVar("Model", bound=BaseModel)
Plain: TypeAlias = "dict[str, Plain] | list[Plain] | str | None"

_MAX_DEPTH = 20
_MAX_EVENTS = 200_000
_NULLS = ("", "~", "null", "Null", "NULL")


class NotPlainYaml(Exception):
    """Text that is no YAML, or uses what quadlog refuses. reason is one phrase, line counts from 1."""

    def __init__(self, reason: str, line: int | None = None) -> None:
        self.reason, self.line = reason, line
        super().__init__(reason if line is None else f"line {line}: {reason}")


def parse_yaml(content: bytes) -> Plain:
    """The one document of a YAML file, scalars as they are written (None for null); the caller converts them.

    Raises NotPlainYaml, also for aliases, anchors, tags, deep nesting, and more than a file of a megabyte needs.
    """
    import yaml

    # What libyaml parses in a second takes the library's own parser half a minute.
    base: Any = getattr(yaml, "CBaseLoader", yaml.BaseLoader)

    class Loader(base):  # type: ignore[misc]
        def construct_scalar(self, node: yaml.ScalarNode) -> str | None:
            return None if not node.style and node.value in _NULLS else node.value

    try:
        _check(yaml.parse(content, Loader))
        return yaml.load(content, Loader)  # noqa: S506 it makes lists, mappings and text
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise NotPlainYaml(f"is no YAML: {clipped(error.problem or error.context)}", line) from None
    except (yaml.YAMLError, UnicodeError) as error:
        raise NotPlainYaml(f"is no YAML: {clipped(str(error).partition(chr(10))[0])}") from None


def _check(events: Iterator[Any]) -> None:
    """Raises NotPlainYaml for what makes a small file large, or a reader recurse without end."""
    import yaml

    depth, reason = 0, ""
    for number, event in enumerate(events):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            reason = "has an alias or anchor (* or &), which quadlog does not read"
        elif tag := getattr(event, "tag", None):
            reason = f"has the tag {clipped(tag)}, which quadlog does not read"
        elif depth > _MAX_DEPTH:
            reason = f"is nested deeper than {_MAX_DEPTH} levels"
        elif number > _MAX_EVENTS:
            reason = f"has more than {_MAX_EVENTS} parts"
        if reason:
            raise NotPlainYaml(reason, event.start_mark.line + 1 if event.start_mark else None)


def read_model(path: Path, model: type[Model], most_bytes: int, under: str = "") -> Model:
    """What a YAML file says, or the mapping under a key of it, as a model; null is as if it were not there.

    Raises OSError, and NotPlainYaml, also where the file is longer, or says what the model does not take.
    """
    with path.open("rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise NotPlainYaml(f"is larger than {most_bytes} bytes")
    said = parse_yaml(content)
    if under and isinstance(said, dict):
        said = said.get(under)
    if not isinstance(said, dict):
        raise NotPlainYaml(f"{under or 'the document'} is no mapping")
    try:
        return model.model_validate({key: value for key, value in said.items() if value is not None})
    except ValidationError as error:
        first = error.errors()[0]
        given = "" if first["type"] == "missing" else f" is {clipped(repr(first['input']), 50)}"
        key = ".".join(map(str, first["loc"]))
        raise NotPlainYaml(f"{f'{key}{given}: ' if key else ''}{first['msg'].removeprefix('Value error, ')}") from None
