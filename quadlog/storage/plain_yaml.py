"""YAML as recorders and map servers write it: mappings, lists and text; what makes a small file large is refused."""

from __future__ import annotations

from typing import TypeAlias

from quadlog.errors import clipped

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

    Raises NotPlainYaml, also for aliases, anchors, merge keys, tags, keys that
    are no text or come twice, deep nesting, and more than a file of a megabyte needs.
    """
    import yaml

    # What libyaml parses in a second takes the library's own parser half a minute.
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    builder = _Builder()
    try:
        for event in yaml.parse(content, Loader=loader):
            try:
                builder.take(event)
            except NotPlainYaml as error:
                line = event.start_mark.line + 1 if event.start_mark else None
                raise NotPlainYaml(error.reason, line) from None
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else None
        raise NotPlainYaml(f"is no YAML: {clipped(error.problem or error.context)}", line) from None
    except (yaml.YAMLError, UnicodeError) as error:
        raise NotPlainYaml(f"is no YAML: {clipped(str(error).partition(chr(10))[0])}") from None
    return builder.document


class _Builder:
    """Values made of a parser's events, without recursion."""

    def __init__(self) -> None:
        self.document: Plain = None
        self._events = self._documents = 0
        self._open: list[dict[str, Plain] | list[Plain]] = []
        self._keys: list[str | None] = []  # of each open mapping, the key whose value comes next

    def take(self, event: object) -> None:
        """The next event. Raises NotPlainYaml."""
        import yaml

        self._events += 1
        if self._events > _MAX_EVENTS:
            raise NotPlainYaml(f"has more than {_MAX_EVENTS} parts")
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise NotPlainYaml("has an alias or anchor (* or &), which quadlog does not read")
        if getattr(event, "tag", None) is not None:
            raise NotPlainYaml(f"has the tag {clipped(event.tag)}, which quadlog does not read")  # type: ignore[attr-defined]
        if isinstance(event, yaml.DocumentStartEvent):
            self._documents += 1
            if self._documents > 1:
                raise NotPlainYaml("has more than one document")
        elif isinstance(event, yaml.ScalarEvent):
            self._scalar(event.value, event.implicit[0])
        elif isinstance(event, yaml.CollectionStartEvent):
            opened: dict[str, Plain] | list[Plain] = {} if isinstance(event, yaml.MappingStartEvent) else []
            self._value(opened)
            self._open.append(opened)
            self._keys.append(None)
            if len(self._open) > _MAX_DEPTH:
                raise NotPlainYaml(f"is nested deeper than {_MAX_DEPTH} levels")
        elif isinstance(event, yaml.CollectionEndEvent):
            self._open.pop()
            self._keys.pop()

    def _scalar(self, text: str, is_plain: bool) -> None:
        if self._open and isinstance(self._open[-1], dict) and self._keys[-1] is None:
            if is_plain and text == "<<":
                raise NotPlainYaml("has a merge key (<<), which quadlog does not read")
            if text in self._open[-1]:
                raise NotPlainYaml(f"has the key {clipped(text)} twice")
            self._keys[-1] = text
        else:
            self._value(None if is_plain and text in _NULLS else text)

    def _value(self, value: Plain) -> None:
        if not self._open:
            self.document = value
        elif isinstance(within := self._open[-1], list):
            within.append(value)
        elif (key := self._keys[-1]) is None:
            raise NotPlainYaml("has a key that is no text")
        else:
            within[key] = value
            self._keys[-1] = None


def text_of(value: Plain, name: str, default: str | None = None) -> str:
    """Text that stands under a name; default for what is missing, if there is one. Raises NotPlainYaml."""
    if value is None and default is not None:
        return default
    if not isinstance(value, str):
        raise NotPlainYaml(f"{name} is no text")
    return value


def number_of(value: Plain, name: str) -> float:
    """A number that stands under a name. Raises NotPlainYaml."""
    text = text_of(value, name)
    try:
        return float(text)
    except ValueError:
        raise NotPlainYaml(f"{name} is no number: {clipped(text, 50)!r}") from None


def list_of(value: Plain, name: str) -> list[Plain]:
    """A list that stands under a name, empty for what is missing. Raises NotPlainYaml."""
    if value is not None and not isinstance(value, list):
        raise NotPlainYaml(f"{name} is no list")
    return value or []


def mapping_of(value: Plain, name: str) -> dict[str, Plain]:
    """A mapping that stands under a name. Raises NotPlainYaml."""
    if not isinstance(value, dict):
        raise NotPlainYaml(f"{name} is no mapping")
    return value
