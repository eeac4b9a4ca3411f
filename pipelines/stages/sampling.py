"""A few evenly spread items of a stream whose length nobody knows beforehand."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

Item = TypeVar("Item")


class EvenSample(Generic[Item]):
    """Keeps every 2^k-th item, k growing with the stream, so that at most twice `wanted` are ever held."""

    def __init__(self, wanted: int) -> None:
        self._wanted = wanted
        self._stride, self._seen = 1, 0
        self._held: list[Item] = []

    def offer(self, make: Callable[[], Item]) -> None:
        """The next item of the stream; `make` is called only when it is kept."""
        if self._wanted and self._seen % self._stride == 0:
            if len(self._held) == 2 * self._wanted:
                self._held = self._held[::2]
                self._stride *= 2
            if self._seen % self._stride == 0:
                self._held.append(make())
        self._seen += 1

    def kept(self) -> list[Item]:
        """At most `wanted` items, spread over the stream, the first one among them."""
        if len(self._held) <= self._wanted:
            return self._held
        step = len(self._held) / self._wanted
        return [self._held[int(index * step)] for index in range(self._wanted)]
