"""How often pieces are read: whoever looks at the first messages of many topics must not decompress them each time."""

from __future__ import annotations

from collections import Counter
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from quadlog.recordings.containers.chunked_reader import Bodies, FirstBodies
from quadlog.recordings.containers.chunks import Body, Entries, Piece
from quadlog.recordings.containers.mcap import McapFormat, open_mcap


class CountingForm:
    """Pieces of 100 bytes, each filled with its offset."""

    def __init__(self) -> None:
        self.loads: Counter[int] = Counter()

    def load(self, piece: Piece, at_most: int | None = None) -> Body:
        self.loads[piece.offset] += 1
        return Body(memoryview(bytes([piece.offset]) * 100), 100)

    def entries(self, body: Body) -> Entries:
        raise NotImplementedError

    def counts(self, piece: Piece) -> None:
        return None


PIECES = [Piece(offset, 1, 10 * offset, 10 * offset + 9) for offset in range(8)]


def one_pass(form: CountingForm, first: FirstBodies, wanted: list[Piece]) -> None:
    bodies = Bodies(form, PIECES, first)
    for piece in wanted:
        for _ in range(3):
            assert bytes(bodies.get(piece).data) == bytes([piece.offset]) * 100
        bodies.drop(piece)
    bodies.close()


def test_a_look_at_the_beginning_reads_no_further_and_only_once() -> None:
    form, first = CountingForm(), FirstBodies()
    for _ in range(5):
        one_pass(form, first, PIECES[:1])
    assert form.loads == {0: 1}


def test_a_whole_pass_reads_every_piece_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("quadlog.recordings.containers.chunked_reader._FIRST_BYTES", 250)
    form, first = CountingForm(), FirstBodies()
    one_pass(form, first, PIECES)
    assert form.loads == dict.fromkeys(range(8), 1)
    one_pass(form, first, PIECES)
    assert form.loads == {0: 1, 1: 1} | dict.fromkeys(range(2, 8), 2)


def test_the_beginning_keeps_to_its_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("quadlog.recordings.containers.chunked_reader._FIRST_BYTES", 99)
    form, first = CountingForm(), FirstBodies()
    one_pass(form, first, PIECES[:1])
    one_pass(form, first, PIECES[:1])
    assert form.loads == {0: 2}


def test_first_messages_of_all_topics_cost_one_reading(
    tmp_path: Path, recordings: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    loads: Counter[int] = Counter()
    load = McapFormat.load

    def counting(form: McapFormat, piece: Piece, at_most: int | None = None) -> Body | None:
        loads[piece.offset] += 1
        return load(form, piece, at_most)

    monkeypatch.setattr(McapFormat, "load", counting)
    with open_mcap(recordings.mcap(tmp_path / "a.mcap", recordings.some())) as container:
        for topic in ("/a", "/b", "/a"):
            assert len(list(islice(container.messages([topic]), 2))) == 2
        assert set(loads.values()) == {1}
        assert recordings.read(container) == recordings.some()
        assert set(loads.values()) == {1}
        assert recordings.read(container) == recordings.some()
        assert set(loads.values()) == {2}  # nothing stays behind a pass that came to its end
