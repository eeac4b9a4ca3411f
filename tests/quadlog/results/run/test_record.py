from __future__ import annotations

import hashlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from quadlog.errors import RecordingNotFound
from quadlog.results import read_run_json
from quadlog.results.run.record import RunRecord, describe_input, describe_input_aside


def test_run_json_says_all_the_contract_names(tiny_run: Path) -> None:
    record = read_run_json(tiny_run)
    assert record["realtime_factor"] == pytest.approx(4.0 / 0.8)
    assert record["quadlog_version"] == "0.1.0"
    assert record["command"] == ["quadlog", "replay", "walk.mcap"]
    assert record["config"]["planner"] == {"name": "ia_star"}
    assert record["input"] == {"path": "walk.mcap", "size_bytes": 1234, "sha256": "ab" * 32}
    assert record["seed"] == 0
    assert record["packages"]["numpy"] == np.__version__
    assert record["host"]["processors"] >= 1
    assert record["topics"][0]["why"] == "the only point cloud"
    assert record["losses"][0] == {
        "cause": "crc",
        "detail": "one chunk is damaged, from 1.0 s to 1.5 s",
        "topic": "/points",
        "count": 5,
    }
    assert record["stages"][0] == {"name": "ingest", "seconds": 0.5, "peak_memory_mb": 120.0}
    assert record["counts"] == {"scans": 40, "scans_without_pose": 0}
    assert record["warnings"] == ["no heading source: yaw is the course"]


def test_what_is_none_is_absent(tiny_record: RunRecord) -> None:
    assert "realtime_factor" not in replace(tiny_record, realtime_factor=None).to_dict()


def test_a_device_is_no_recording_and_is_not_read_to_its_end() -> None:
    with pytest.raises(RecordingNotFound, match="no regular file"):
        describe_input(Path("/dev/zero"))


def test_a_bag_folders_hash_covers_its_recordings_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "bag_0.mcap").write_bytes(b"one")
    (tmp_path / "metadata.yaml").write_text("version: 5")
    before = describe_input(tmp_path)
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "derived.mcap").write_bytes(b"a result")
    (tmp_path / "notes.txt").write_text("by hand")
    assert describe_input(tmp_path) == before
    (tmp_path / "bag_1.mcap").write_bytes(b"two")
    assert describe_input(tmp_path).sha256 != before.sha256


def test_a_files_hash_is_what_sha256sum_says(tmp_path: Path) -> None:
    content = bytes(range(256)) * 10_000
    (tmp_path / "walk.mcap").write_bytes(content)
    described = describe_input(tmp_path / "walk.mcap")
    assert described.size_bytes == len(content)
    assert described.sha256 == hashlib.sha256(content).hexdigest()


def test_a_folders_hash_sees_names_borders_and_contents(tmp_path: Path) -> None:
    def described(**files: bytes) -> str:
        folder = tmp_path / "-".join(["of", *files, *(each.decode() for each in files.values())])
        folder.mkdir()
        for name, content in files.items():
            (folder / f"{name}.mcap").write_bytes(content)
        return describe_input(folder).sha256

    assert len({described(a=b"xy", b=b""), described(a=b"x", b=b"y"), described(a=b"xy", c=b""), described()}) == 4
    assert describe_input(tmp_path / "of-a-b-xy-").size_bytes == 2


def test_what_is_described_aside_is_the_same_and_so_is_what_goes_wrong(tmp_path: Path) -> None:
    (tmp_path / "walk.mcap").write_bytes(bytes(1 << 22))
    assert describe_input_aside(tmp_path / "walk.mcap").result() == describe_input(tmp_path / "walk.mcap")
    with pytest.raises(RecordingNotFound, match=r"gone\.mcap: no such file"):
        describe_input_aside(tmp_path / "gone.mcap").result()
