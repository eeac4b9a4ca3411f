"""Message definitions as text become checked type tables.

Definitions come from strangers, and rosbags turns them into Python code. What
reaches it here has been parsed, bounded and stripped first: names are plain
identifiers, constants are dropped, only types the message needs are kept,
references neither dangle nor loop, and fixed arrays are of sane length.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg

LARGEST_DEFINITION_BYTES = 1 << 20
LONGEST_FIXED_ARRAY = 4096  # of strings or messages, which become a line of code each
DEEPEST_NESTING = 32

TYPE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*){1,3}")
FIELD_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
SEPARATOR = re.compile(r"^={3,}[ \t]*$", re.MULTILINE)
IDL_LITERAL_OR_COMMENT = re.compile(r'"(?:\\.|[^"\\])*"|//[^\n]*|/\*.*?\*/', re.DOTALL)

# As rosbags describes types: name -> (constants, [(field, descriptor)]).
Types = dict[str, tuple[list, list]]
Lookup = Callable[[str], Types]


class BadDefinition(ValueError):
    """A definition that cannot be used; says why."""


def parse_definition(text: bytes | str, type_name: str, encoding: str) -> Types:
    """Every type in one definition text. encoding: ``ros1msg``, ``ros2msg`` or ``ros2idl``."""
    if len(text) > LARGEST_DEFINITION_BYTES:
        raise BadDefinition(f"its definition is larger than {LARGEST_DEFINITION_BYTES} bytes")
    if not TYPE_NAME.fullmatch(type_name):
        raise BadDefinition(f"{type_name[:80]!r} is no type name")
    decoded = text if isinstance(text, str) else text.decode("utf-8", "replace")
    decoded = decoded.replace("\r\n", "\n").rstrip("\0")
    parse = {"ros1msg": _parse_msg, "ros2msg": _parse_msg, "ros2idl": _parse_idl}.get(encoding)
    if parse is None:
        raise BadDefinition(f"its definition is written in {encoding[:40]!r}, which quadlog does not read")
    try:
        return parse(decoded, type_name)
    except BadDefinition:
        raise
    except Exception as error:  # the parser fails in many ways on what is not a definition
        raise BadDefinition(f"its definition cannot be parsed ({type(error).__name__})") from error


def needed_types(types: Types, type_name: str, elsewhere: Lookup) -> Types:
    """The types that type_name is made of, checked, without constants.

    elsewhere gives the table of a type that the definition leaves out (it
    returns an empty table for one it does not know).
    """
    needed: Types = {}

    def visit(name: str, depth: int) -> None:
        """Take a type and all that it contains into `needed`. Raises BadDefinition."""
        if depth > DEEPEST_NESTING:
            raise BadDefinition(f"{name[:80]} contains itself, or is nested too deeply")
        if name in needed:
            return
        found = types.get(name) or elsewhere(name).get(name)
        if found is None:
            raise BadDefinition(f"the definition of {name[:80]} is missing")
        fields = found[1]
        _check_fields(name, fields)
        for _, descriptor in fields:
            inner = _inner(descriptor)
            if inner[0] == Nodetype.NAME:
                visit(inner[1], depth + 1)
        needed[name] = ([], fields)

    visit(type_name, 0)
    return needed


def _check_fields(name: str, fields: list) -> None:
    if not TYPE_NAME.fullmatch(name):
        raise BadDefinition(f"{name[:80]!r} is no type name")
    for field, descriptor in fields:
        if not FIELD_NAME.fullmatch(field):
            raise BadDefinition(f"{field[:80]!r} is no field name")
        if descriptor[0] == Nodetype.ARRAY and not _is_number(_inner(descriptor)):
            length = descriptor[1][1]
            if not 0 < length <= LONGEST_FIXED_ARRAY:
                raise BadDefinition(f"{name}.{field} is an array of {str(length)[:20]}")


def _inner(descriptor: tuple) -> tuple:
    return descriptor[1][0] if descriptor[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else descriptor


def _is_number(inner: tuple) -> bool:
    return bool(inner[0] == Nodetype.BASE and inner[1][0] not in ("string", "wstring"))


def _parse_msg(text: str, type_name: str) -> Types:
    # Writers draw the line between types in different lengths; the parser wants 80.
    return dict(get_types_from_msg(SEPARATOR.sub("=" * 80, text) + "\n", type_name))


def _parse_idl(text: str, type_name: str) -> Types:
    del type_name
    types: Types = {}
    for part in SEPARATOR.split(text):
        body = re.sub(r"\A\s*IDL: [^\n]*\n", "", part)
        if body.strip():
            _refuse_expressions(body)
            types.update(get_types_from_idl(body))
    return types


def _refuse_expressions(text: str) -> None:
    """Constant arithmetic, which no message generator writes, could keep the parser busy for ever."""
    bare = IDL_LITERAL_OR_COMMENT.sub("", text)
    if re.search(r"<<|\([^()]*\(|[0-9]{20}", bare):
        raise BadDefinition("its IDL has computed constants, which quadlog does not read")
