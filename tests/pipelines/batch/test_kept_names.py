from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from quadlog.pipelines.batch.plan import kept_names

RECORD = {"quadlog_version": "0", "command": [], "config": {}, "options": {}, "seed": 0, "recorded_s": 1.0}
RECORD |= {"host": {}, "packages": {}}


def replayed(output: Path, recordings: list[Path]) -> dict[Path, str]:
    """What `quadlog replay --resume` would leave of the recordings; returns who would have which folder."""
    names = dict(zip(recordings, kept_names(recordings, output), strict=True))
    for recording, name in names.items():
        record = output / name / "run.json"
        if not record.exists():
            record.parent.mkdir(parents=True)
            record.write_text(json.dumps(RECORD | {"input": {"path": str(recording), "size_bytes": 0}}))
    return names


A, B, C = (Path(f"/season/{each}/rec.mcap") for each in "abc")


ANY = [A, B, C, Path("/x/rec.bag"), Path("/x/rec-2.mcap"), Path("/x/Rec.db3")]


@example([[C, B], [B, A], [A]])
@given(st.lists(st.lists(st.sampled_from(ANY), unique=True), max_size=4))
def test_no_two_share_a_folder_and_none_ever_changes_its_own(
    tmp_path_factory: pytest.TempPathFactory, batches: list[list[Path]]
) -> None:
    output = tmp_path_factory.mktemp("runs")
    owners: dict[str, Path] = {}
    for batch in batches:
        names = replayed(output, batch)
        assert len({name.casefold() for name in names.values()}) == len(batch)
        mine = {recording: name for name, recording in owners.items()}
        assert all(names[each] == mine[each] for each in batch if each in mine)
        owners |= {name: each for each, name in names.items() if name not in owners}
