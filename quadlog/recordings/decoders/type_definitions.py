"""Message definitions as text become checked type tables.

Definitions are untrusted. Parsing takes rosbags about 1 ms a line (5 ms in IDL), so lines are counted before; comments
and annotations, of which there may be many, are taken out. Types that come out of here neither dangle nor loop, and
their names are plain.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import lru_cache

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_idl, get_types_from_msg

LARGEST_DEFINITION_BYTES = 1 << 20
LARGEST_STRIPPED_CHARS = 1 << 15
MOST_LINES = 1000
MOST_IDL_SIGNS = 320  # of those that end, open or divide a declaration
MOST_FIXED_VALUES = 10_000  # of a message whose sequences are empty
DEEPEST_NESTING = 32

TYPE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*){1,3}")
SEPARATOR = re.compile(r"^={3,}[ \t]*$", re.MULTILINE)
# What is not closed ends with the text, so that no part is searched again for its end.
IDL_LITERAL = r'"(?:\\.|[^"\\])*+\\?(?:"|\Z)'
IDL_COMMENT = r"//[^\n]*|/\*(?:.*?\*/|.*)"
IDL_ANNOTATION = rf"@[\w:]+\s*+(?:\((?:{IDL_LITERAL}|[^()\"])*+\))?"
IDL_ASIDE = re.compile(f"(?P<literal>{IDL_LITERAL})|{IDL_COMMENT}|{IDL_ANNOTATION}", re.DOTALL)

# As rosbags describes types: name -> (constants, [(field, descriptor)]).
Types = dict[str, tuple[list, list]]
Lookup = Callable[[str], Types]

ARRAYS = (Nodetype.ARRAY, Nodetype.SEQUENCE)


class BadDefinition(ValueError):
    """A definition that cannot be used; says why."""


@lru_cache(maxsize=64)  # by all topics of one type
def parse_definition(text: bytes | str, type_name: str, encoding: str) -> Types:
    """Every type in one definition text, not to be changed. encoding: ``ros1msg``, ``ros2msg`` or ``ros2idl``."""
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
    flat: dict[str, int] = {}

    def visit(name: str, depth: int) -> None:
        """Take all that a type contains into `needed`, and then the type. Raises BadDefinition."""
        if depth > DEEPEST_NESTING:
            raise BadDefinition(f"{name[:80]} contains itself, or is nested too deeply")
        if name in needed:
            return
        found = types.get(name) or elsewhere(name).get(name)
        if found is None or not TYPE_NAME.fullmatch(name):
            raise BadDefinition(f"the definition of {name[:80]} is missing")
        flat[name] = 0
        for field, (kind, detail) in found[1]:
            if kind == Nodetype.ARRAY and detail[1] <= 0:
                raise BadDefinition(f"{name}.{field} is an array of {str(detail[1])[:20]}")
            kind, detail = detail[0] if kind in ARRAYS else (kind, detail)
            if kind == Nodetype.NAME:
                visit(detail, depth + 1)
            flat[name] += 1 + (flat[detail] if kind == Nodetype.NAME else 0)
        # Types within types can make 2^32 fields of a few lines.
        if flat[name] > MOST_FIXED_VALUES:
            raise BadDefinition(f"each {name} has more than {MOST_FIXED_VALUES} values")
        needed[name] = ([], found[1])

    visit(type_name, 0)
    return needed


def _parse_msg(text: str, type_name: str) -> Types:
    lines = [line.strip() for line in SEPARATOR.sub("=" * 80, text).split("\n")]
    lines = [line for line in lines if line and not line.startswith("#")]
    # Writers draw the line between types in different lengths; the parser wants 80.
    stripped = "\n".join(lines) + "\n"
    _check_length(stripped, len(lines), MOST_LINES)
    return dict(get_types_from_msg(stripped, type_name))


def _parse_idl(text: str, _: str) -> Types:
    stripped = IDL_ASIDE.sub(lambda match: match["literal"] or " ", text)
    stripped = re.sub(r"\s+", lambda match: "\n" if "\n" in match[0] else " ", stripped)
    _check_length(stripped, sum(map(stripped.count, ";,{[<")), MOST_IDL_SIGNS)
    types: Types = {}
    for part in SEPARATOR.split(stripped):
        body = re.sub(r"\A\s*IDL: [^\n]*\n", "", part)
        # Constant arithmetic, which no message generator writes, could keep the parser busy for ever.
        if re.search(r"<<|\([^()]*\(|[0-9]{20}", re.sub(IDL_LITERAL, "", body, flags=re.DOTALL)):
            raise BadDefinition("its IDL has computed constants, which quadlog does not read")
        types |= get_types_from_idl(body) if body.strip() else {}
    return types


def _check_length(stripped: str, declarations: int, most: int) -> None:
    if declarations > most or len(stripped) > LARGEST_STRIPPED_CHARS:
        raise BadDefinition("its definition is longer than any message needs")
