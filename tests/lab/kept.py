"""Progress that keeps what a replay says."""

from __future__ import annotations

from quadlog.pipelines.executor.progress import Progress


class Kept(Progress):
    """Keeps the lines."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, text: str) -> None:
        """Keep one line."""
        self.lines.append(text)
