"""Every message of quadlog, as the code has it, with what to do about it: the page troubleshooting.md."""

from __future__ import annotations

import ast
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from itertools import chain
from pathlib import Path

from quadlog import errors

HERE = Path(__file__).parent
SOURCES = [
    path for room in ("quadlog", "pipelines", "cli") for path in sorted((HERE.parent / room).rglob("*.py"))
    if not re.search(r"results/(?!export)|metrics/planner_verdict|pipelines/tables/|cli/main",
                     str(path.relative_to(HERE.parent)))
]  # fmt: skip
"""Without those whose texts are parts of pages and tables."""

TELLS = re.compile(r"(warn|note|warnings|notes|UNUSUAL)$")
"""Calls and lists of these names take messages; functions of MAKERS return them."""
MAKERS = re.compile(r"(warnings?|notes|words|mounts|links)$")
LOSSES = ("Loss", "Damaged")

HEADER = """# Troubleshooting by message

Search this page for a few words of what quadlog printed; `…` stands for what varies. `make docs` writes this page from
`docs/troubleshooting.toml` and the messages in the code; a test fails when it is out of date.

## Exit codes

| exit code | meaning |
|---|---|
| 0 | done |
| 1 | failed: one line on stderr says why. A traceback is a bug in quadlog: please report it |
| 2 | wrong usage: an option or a name does not exist |
| 3 | done, with loss: part of the recording was not read, or over 5 % of it had no position; `report.html` lists it |
| 4 | a bound does not hold (`quadlog check`), a condition of `--fail-if` is true, or two runs differ (`quadlog diff`) |

Warnings and losses are on stderr, in `run.json`, and at the end of the report. A line without `warning:` or `lost:` in
front is a note: it says which choice led to the result, and needs no action.

`compiling for the first time on this machine` appears once after each installation: numba compiles loops to machine
code and keeps them. Later starts take about a second.
"""


def troubleshooting_page() -> str:
    """The page. Raises ValueError for a message, an error or a loss without an entry, and for what nothing prints."""
    messages, errors_said = code_messages(), error_messages()
    known = {*messages, *errors_said, *(f"loss: {cause}" for cause in loss_causes())}
    lines, covered, wrong = [HEADER], set(), []
    for part in tomllib.loads((HERE / "troubleshooting.toml").read_text(encoding="utf-8"))["part"]:
        lines.append(f"## {part['title']}\n")
        for entry in part["entry"]:
            said = {each: [each] if each in known else [text for text in messages if each in text]
                    for each in entry["says"]}  # fmt: skip
            wrong += [f"nothing in the code says {each!r}" for each, found in said.items() if not found]
            found = list(chain(*said.values()))
            covered |= set(found)
            lines += [f"### {entry['title']}\n", *_printed(found, errors_said)]
            lines.append(f"\n{entry['why']}\n\n**Remedy:** {entry['do']}\n")
    if wrong := [*wrong, *(f"no entry for {each!r}" for each in sorted(known - covered))]:
        raise ValueError("docs/troubleshooting.toml: " + "; ".join(wrong))
    return "\n".join(lines)


def _printed(found: Sequence[str], errors_said: Mapping[str, str]) -> Iterator[str]:
    """A line for each message, and one for all losses."""
    if causes := [f"`{text[6:]}`" for text in found if text.startswith("loss: ")]:
        yield f"- `lost: …`, in `run.json` with the cause {', '.join(causes)}"
    for text in (text for text in found if not text.startswith("loss: ")):
        if text not in errors_said:
            yield f"- `{text}`"
        elif re.search("[a-z]{2}", errors_said[text]):
            yield f"- `{errors_said[text]}` (`{text}`)"
        else:  # a path and a reason: the class says more
            yield f"- {getattr(errors, text).__doc__.splitlines()[0]} (`{text}`)"


def error_messages() -> dict[str, str]:
    """What each class of error prints, by name, with … for what varies."""
    printed, templates = {"QuadlogError": "…"}, {"QuadlogError": ""}
    for node in _parsed(Path(errors.__file__)).body:
        if isinstance(node, ast.ClassDef) and (base := getattr(node.bases[0], "id", "")) in printed:
            calls = [each for each in ast.walk(node) if isinstance(each, ast.Call) and each.args]
            own = [_pattern(each.args[-1]) for each in calls if ast.unparse(each.func) == "super().__init__"]
            given = {each.targets[0].id: each.value.value for each in node.body
                     if isinstance(each, ast.Assign) and isinstance(each.value, ast.Constant)}  # fmt: skip
            template = templates[node.name] = given.get("template", templates[base])
            texts = [text for text in own if text.strip("… ")]
            if given:
                texts.append(re.sub("{.*?}", "…", template.replace("{reason}", given.get("usual") or "…")))
            elif not own and 0 < len(raised := _raised(node.name)) < 3:  # its text is where it is raised
                texts = ["` or `".join(template.replace("{reason}", text).replace("{path}", "…") or text
                                       for text in raised)]  # fmt: skip
            printed[node.name] = re.sub("…+", "…", texts[-1]) if texts else printed[base]
    return {name: text for name, text in printed.items() if name != "QuadlogError"}


def _raised(name: str) -> list[str]:
    """The texts with which a class of errors is raised."""
    calls = [node for path in SOURCES for node in ast.walk(_parsed(path)) if isinstance(node, ast.Call)]
    return [_pattern(each.args[-1]) for each in calls if ast.unparse(each.func) == name and each.args]


def loss_causes() -> set[str]:
    """The words that a loss of a recording may have as its cause."""
    calls = [node for path in SOURCES for node in ast.walk(_parsed(path)) if isinstance(node, ast.Call)]
    named = [(each.func.id, each.args) for each in calls if isinstance(each.func, ast.Name)]
    given = [args[0 if name == "Loss" else 1 :][:1] for name, args in named if name in LOSSES]
    return {arg.value for args in given for arg in args if isinstance(arg, ast.Constant)}


def code_messages() -> list[str]:
    """The texts of all warnings and notes, with … for what varies."""
    texts = dict.fromkeys(text for path in SOURCES for text in _of_module(_parsed(path)))
    return [text for text in texts if len(re.findall(r"[a-z]{2,}", text)) > 1 and "SELECT" not in text]


@cache
def _parsed(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def _of_module(module: ast.Module) -> Iterator[str]:
    nodes = list(ast.walk(module))
    given = [
        each.args[_takes_messages(each.func) - 1]
        for each in nodes
        if isinstance(each, ast.Call) and each.args and _takes_messages(each.func)
    ]
    names = {each.id for each in given if isinstance(each, ast.Name)}
    for each in given:
        yield from _texts(each)
    for each in nodes:
        if isinstance(each, ast.Assign) and isinstance(each.targets[0], ast.Name):
            if each.targets[0].id in names or TELLS.search(each.targets[0].id):
                yield from _texts(each.value)
        elif isinstance(each, ast.FunctionDef) and MAKERS.search(each.name):
            for inner in ast.walk(each):
                if isinstance(inner, (ast.Return, ast.Yield, ast.Assign, ast.AugAssign)) and inner.value is not None:
                    yield from (text for text in _texts(inner.value) if len(text.split()) > 4)
                elif isinstance(inner, ast.Call) and getattr(inner.func, "attr", "") in ("append", "insert"):
                    yield from _texts(inner.args[-1])


def _takes_messages(function: ast.expr) -> int:
    """Which argument of a call is a message, counted from 1; 0 for none."""
    if isinstance(function, ast.Name):
        return function.id == "QuadlogError"
    if not isinstance(function, ast.Attribute):
        return 0
    if function.attr in ("append", "insert") and TELLS.search(ast.unparse(function.value)):
        return 1 if function.attr == "append" else 2
    return bool(TELLS.search(function.attr))


def _texts(node: ast.expr) -> Iterator[str]:
    """The texts that an expression may be, or that are in its list."""
    if isinstance(node, (ast.List, ast.Tuple, ast.Dict, ast.IfExp, ast.Starred, ast.ListComp)):
        for part in (name for name in ("elts", "values", "body", "orelse", "value", "elt") if name in node._fields):
            inner = getattr(node, part)
            for each in inner if isinstance(inner, list) else [inner]:
                yield from _texts(each)
    elif isinstance(node, (ast.Constant, ast.JoinedStr, ast.BinOp)):
        yield re.sub("…+", "…", _pattern(node))


def _pattern(node: ast.expr) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(map(_pattern, node.values))
    return _pattern(node.left) + _pattern(node.right) if isinstance(node, ast.BinOp) else "…"
