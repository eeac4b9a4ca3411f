"""What is to be known of a stage beside its files: lines for the user, and numbers for `run.json`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from quadlog.pipelines.executor.progress import Progress, Silent, StageClock
from quadlog.recordings.containers.container import Loss


@dataclass
class Journal:
    """Filled by one stage, kept with its result, and added to that of the whole replay.

    choices: those of the notes that come first. losses: of the recording and of positions. topics: role -> topics that
    were used in it, empty for those detected.
    clock: the stage's time and memory. progress: gets every line once; shown: those it has got.
    """

    progress: Progress = field(default_factory=Silent)
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    choices: list[str] = field(default_factory=list)
    losses: list[Loss] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)
    topics: dict[str, tuple[str, ...]] = field(default_factory=dict)
    clock: StageClock = field(default_factory=StageClock)
    shown: set[str] = field(default_factory=set)

    def page(self) -> Journal:
        """A journal for one stage, whose lines are shown at once."""
        return Journal(self.progress, shown=self.shown)

    def warn(self, *texts: str) -> None:
        """Lines that a user should look at."""
        self._add(self.warnings, texts, "warning: ")

    def note(self, *texts: str, first: bool = False) -> None:
        """Choices that decided the result. first: those that are shown to everybody."""
        self.choices += texts if first else ()
        self._add(self.notes, texts)

    def lose(self, losses: Iterable[Loss]) -> None:
        """What was in the recording and could not be used."""
        for loss in losses:
            if loss not in self.losses:
                self.losses.append(loss)
                self._show(f"lost: {loss.topic + ': ' if loss.topic else ''}{loss.detail}")

    def count(self, name: str, amount: int = 1) -> None:
        """Add to a number of `run.json`."""
        self.counts[name] = self.counts.get(name, 0) + int(amount)

    def use(self, role: str, *topics: str) -> None:
        """Topics that played a role; by default those detected for it."""
        self.topics[role] = topics

    def add(self, kept: Mapping[str, Any]) -> None:
        """Everything of a stage, as `to_json` of its page gave it."""
        self.warn(*kept["warnings"])
        self.choices += kept.get("choices", ())
        self.note(*kept["notes"])
        self.lose(Loss(**each) for each in kept["losses"])
        self.counts |= kept["counts"]
        self.topics |= {role: tuple(topics) for role, topics in kept["topics"].items()}
        for name, seconds in kept["seconds"].items():
            self.clock.seconds[name] = self.clock.seconds.get(name, 0.0) + seconds
        self.clock.peak_memory_mb |= kept["peak_memory_mb"]

    def _add(self, lines: list[str], texts: Iterable[str], before: str = "") -> None:
        for text in texts:
            if text not in lines:
                lines.append(text)
                self._show(before + text)

    def _show(self, line: str) -> None:
        if line not in self.shown:
            self.shown.add(line)
            (self.progress.note if line in self.notes and line not in self.choices else self.progress.say)(line)

    def to_json(self) -> dict[str, Any]:
        """As `add` takes it."""
        names = ("warnings", "notes", "choices", "counts", "topics")
        clock = {"seconds": self.clock.seconds, "peak_memory_mb": self.clock.peak_memory_mb}
        losses = [asdict(each) for each in self.losses]
        return {name: getattr(self, name) for name in names} | {"losses": losses} | clock
