"""Edits that a case applies to a sound file, and the mutations that the route without atheris makes."""

from __future__ import annotations

from collections.abc import Sequence

from hypothesis import strategies as st

_EDIT_BYTES = 6
_MOST_EDITS = 16
_INTERESTING = (0, 1, 0x7F, 0x80, 0xFF, 0x20, 0x0A, 0x30)


def edited(data: bytes, edits: bytes) -> bytes:
    """The data after up to 16 edits of six bytes each: what to do, a byte for it, and a place (32 bits, modulo).

    Bytes are overwritten, cut out, or the end is cut off; nothing is added, so that nothing may be found more often.
    """
    out = bytearray(data)
    for start in range(0, min(len(edits), _EDIT_BYTES * _MOST_EDITS) - _EDIT_BYTES + 1, _EDIT_BYTES):
        what, value = edits[start], edits[start + 1]
        if not out:
            break
        place = int.from_bytes(edits[start + 2 : start + 6], "little") % len(out)
        if what % 8 < 4:
            out[place] = value
        elif what % 8 == 4:
            out[place] ^= 1 << value % 8
        elif what % 8 == 5:
            out[place : place + 8] = bytes([value]) * len(out[place : place + 8])
        elif what % 8 == 6:
            del out[place : place + value + 1]
        else:
            del out[place:]
    return bytes(out)


def mutations(seeds: Sequence[bytes], tokens: Sequence[bytes]) -> st.SearchStrategy[bytes]:
    """A seed with a few changes: bytes, runs of a seed, and tokens of the format, put in, over or taken out."""
    pieces = st.one_of(
        st.binary(min_size=1, max_size=8),
        st.sampled_from([bytes([value]) * length for value in _INTERESTING for length in (1, 4, 8)]),
        *([st.sampled_from(list(tokens))] if tokens else []),
    )
    change = st.tuples(st.integers(0, 5), st.integers(0, 1 << 16), st.integers(0, 64), pieces)
    return st.builds(_mutated, st.sampled_from(list(seeds)), st.lists(change, min_size=1, max_size=8))


def _mutated(seed: bytes, changes: Sequence[tuple[int, int, int, bytes]]) -> bytes:
    out = bytearray(seed)
    for what, place, length, piece in changes:
        at = place % (len(out) + 1)
        if what <= 1:
            out[at : at + len(piece)] = piece
        elif what == 2:
            out[at:at] = piece
        elif what == 3:
            del out[at : at + length]
        elif what == 4:
            out[at:at] = out[at : at + length] * 2
        else:
            out[at:at] = piece * (length + 1)
    return bytes(out)
