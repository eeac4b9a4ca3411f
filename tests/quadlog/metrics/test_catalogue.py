from __future__ import annotations

import re
from pathlib import Path

import pytest

from quadlog.metrics.catalogue import CATALOGUE

REFERENCES = (Path(__file__).parents[3] / "docs" / "references.md").read_text()
UNITS = {"_m": "m", "_s": "s", "_rad": "rad", "_nm": "N·m", "_degps": "deg/s", "_hz": "Hz"}


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_entry_says_all_there_is(name):
    entry = CATALOGUE[name]
    assert entry.name == name
    assert all([entry.meaning, entry.formula, entry.source, entry.counted])
    suffix = next((each for each in UNITS if name.endswith(each)), "")
    assert entry.unit == UNITS.get(suffix, "")
    for key in re.findall(r"\[[^]]+\]", entry.source):
        assert f"| {key} |" in REFERENCES
