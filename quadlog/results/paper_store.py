"""A paper's table as TABLE.json: unrounded, with what it was measured with, so that it need not be measured again."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from quadlog.results.paper_rows import PaperRow, PaperTable, Picture, RowGroup

LARGEST_BYTES = 16_000_000
"""No table comes near; of a larger file, which is none of ours, no more is read."""


@dataclass(frozen=True, slots=True)
class Origin:
    """All that decides what a table holds. code: a digest of quadlog and of the packages under it; the rest as asked.

    A table that draws nothing says in itself that it is neither fast nor of a seed, whatever was asked.
    """

    code: str
    fast: bool
    seed: int


@dataclass(frozen=True, slots=True)
class SavedTable:
    """A table as it lies in a folder, and what it was measured with."""

    table: PaperTable
    origin: Origin


def picture_file(table: PaperTable, picture: Picture) -> str:
    """Where a picture lies, beside the page."""
    return f"{table.name}-{picture.name}.png"


def json_bytes(saved: SavedTable) -> bytes:
    """The table but for its pictures' pixels, of which it has the SHA-256; with a SHA-256 of itself."""
    table = asdict(saved.table)
    for picture in table["pictures"]:
        picture["sha256"] = hashlib.sha256(picture.pop("png")).hexdigest()
    body = {"origin": asdict(saved.origin), "table": table}
    return (json.dumps(body | {"sha256": _digest(body)}, indent=1, ensure_ascii=False) + "\n").encode()


def load_saved(folder: Path, name: str) -> SavedTable | None:
    """The table that lies in a folder; None when there is none, or not all of it as it was written."""
    try:
        with (folder / f"{name}.json").open("rb") as stream:
            body = json.loads(stream.read(LARGEST_BYTES))
        if body.pop("sha256") != _digest(body) or body["table"]["name"] != name:
            return None
        return SavedTable(_table(folder, body["table"]), Origin(**body["origin"]))
    except (OSError, ValueError, RecursionError, AttributeError, KeyError, TypeError, AssertionError):
        return None


def _digest(body: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()


def _table(folder: Path, fields: dict[str, Any]) -> PaperTable:
    """Raises what `load_saved` takes for a damaged file."""
    groups = tuple(
        RowGroup(group["title"], group["text"], tuple(PaperRow(**row) for row in group["rows"]))
        for group in fields.pop("groups")
    )
    pictures = tuple(_picture(folder, fields["name"], each) for each in fields.pop("pictures"))
    return PaperTable(**fields | {"errata": tuple(fields["errata"])}, groups=groups, pictures=pictures)


def _picture(folder: Path, name: str, fields: dict[str, Any]) -> Picture:
    """Raises ValueError when the file beside the table is another one than was written."""
    sha256 = fields.pop("sha256")
    # Looked for among the files there are, so that a name never leads elsewhere.
    files = {path.name: path for path in folder.glob(f"{name}-*.png")}
    png = files[f"{name}-{fields['name']}.png"].read_bytes()
    if hashlib.sha256(png).hexdigest() != sha256:
        raise ValueError(name)
    return Picture(**fields, png=png)
