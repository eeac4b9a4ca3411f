"""Records that are kept until positions are known: in memory, then in a file that nobody sees."""

from __future__ import annotations

from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from quadlog.pipelines.stages.scans import Spill


@given(records=st.lists(st.lists(st.binary(max_size=40), max_size=3)), bound=st.integers(1, 60))
def test_records_come_back_as_they_were_and_more_than_once(records, bound, tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    with Spill(folder, bound) as spill:
        for record in records[: len(records) // 2]:
            spill.append(*record)
        list(spill)
        for record in records[len(records) // 2 :]:
            spill.append(*record)
        for _ in range(2):
            assert list(spill) == [b"".join(record) for record in records]
        assert len(spill) == len(records)
        assert list(folder.iterdir()) == [], "the file has no name"


def test_what_does_not_fit_into_memory_lies_beside_the_run(tmp_path):
    def open_there() -> list[str]:
        targets = [str(each.readlink()) for each in Path("/proc/self/fd").iterdir() if each.is_symlink()]
        return [target for target in targets if target.startswith(str(tmp_path))]

    with Spill(tmp_path, 1000) as spill:
        spill.append(bytes(900))
        assert open_there() == []
        spill.append(bytes(101))
        assert len(open_there()) == 1
    assert open_there() == []
    assert list(tmp_path.iterdir()) == []
