"""Columns of integers and maps as one deflated block of a page, which templates/player_scene.js unpacks."""

from __future__ import annotations

import base64
import zlib

import numpy as np

from quadlog.messages import Float, Int

UNIT_M, UNIT_S = 1e-3, 1e-3
"""What 1 stands for in the packed columns."""
NO_YAW = 100_000
"""A yaw that is not known; known ones are within -31416 and 31416."""
_LEVEL = 6
_WORD = 4


class Packing:
    """Columns of integers on their way into the page."""

    def __init__(self) -> None:
        self.lengths: list[int] = []
        self._parts: list[bytes] = []

    def add(self, values: Float, unit: float) -> int:
        """The number of a column with values (N,), finite, in whole units."""
        return self.add_integers(np.rint(values / unit))

    def add_integers(self, values: Float | Int) -> int:
        """The number of a column with whole numbers (N,) of less than 2^30."""
        whole = values.astype(np.int64)
        steps = whole - np.concatenate([[0], whole[:-1]])
        zigzag = ((steps << 1) ^ (steps >> 63)).astype("<u4")
        self._parts.append(zigzag.view(np.uint8).reshape(-1, _WORD).T.tobytes())
        self.lengths.append(len(values))
        return len(self.lengths) - 1

    def add_bytes(self, content: bytes) -> None:
        """What follows the columns, and is added after all of them."""
        self._parts.append(content)

    def finish(self) -> str:
        """Everything, deflated, in base64."""
        return base64.b64encode(zlib.compress(b"".join(self._parts), _LEVEL)).decode()
