"""All targets by name: a new one is a function, its seeds, and a line here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from fuzzing.targets import recordings, runs, texts


@dataclass(frozen=True)
class Target:
    """case: what is done with one input, in a folder of its own; seeds: sound inputs; tokens: words of the format.

    most_cpu_s: what one input may take.
    """

    case: Callable[[Path, bytes], None]
    seeds: Callable[[], list[bytes]]
    tokens: Sequence[bytes] = ()
    most_cpu_s: float = 2.0


TARGETS = {
    "containers": Target(recordings.containers, recordings.container_seeds),
    "damage": Target(recordings.damage, recordings.damage_seeds),
    "split": Target(recordings.split, recordings.split_seeds, recordings.SPLIT_TOKENS),
    "definitions": Target(recordings.definitions, recordings.definition_seeds, recordings.DEFINITION_TOKENS),
    "payloads": Target(recordings.payloads, recordings.payload_seeds, recordings.PAYLOAD_TOKENS),
    "urls": Target(texts.urls, texts.url_seeds, texts.URL_TOKENS),
    "toml": Target(texts.toml, texts.toml_seeds, texts.TOML_TOKENS),
    "maps": Target(texts.maps, texts.map_seeds, texts.MAP_TOKENS),
    "lines": Target(texts.lines, texts.line_seeds, texts.LINE_TOKENS),
    "run-files": Target(runs.run_files, runs.run_file_seeds, runs.RUN_TOKENS),
    "run-values": Target(runs.run_values, runs.run_value_seeds, most_cpu_s=20.0),
}
