"""How often pieces are read: whoever looks at the first messages of many topics must not decompress them each time."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from quadlog.recordings.containers import chunked_reader
from quadlog.recordings.containers.chunks import Body, Piece
from quadlog.recordings.containers.mcap import McapFormat
from quadlog.recordings.containers.open import open_container


@pytest.mark.parametrize(("room_bytes", "loads_of_three_looks"), [(1 << 24, 1), (99, 3)])
def test_first_messages_of_all_topics_cost_one_reading_where_there_is_room(
    tmp_path: Path, recordings: Any, monkeypatch: pytest.MonkeyPatch, room_bytes: int, loads_of_three_looks: int
) -> None:
    loads: Counter[int] = Counter()
    load = McapFormat.load

    def counting(form: McapFormat, piece: Piece, at_most: int | None = None) -> Body | None:
        loads[piece.offset] += 1
        return load(form, piece, at_most)

    monkeypatch.setattr(chunked_reader, "_FIRST_BYTES", room_bytes)
    monkeypatch.setattr(McapFormat, "load", counting)
    with open_container(recordings.mcap(tmp_path / "a.mcap", recordings.some())) as container:
        for topic in ("/a", "/b", "/a"):
            assert len(list(islice(container.messages([topic]), 2))) == 2
        assert set(loads.values()) == {loads_of_three_looks}
        assert len(loads) == 1  # nothing is read ahead of a look
        for passes in (0, 1):  # nothing stays behind a pass that came to its end
            before = Counter(loads)
            assert recordings.read(container) == recordings.some()
            more = loads - before
            again = {min(before)} if room_bytes > 99 and passes == 0 else set()
            assert set(more.values()) == {1}
            assert len(more) == len(loads) - len(again)
