"""What a simulated walk leaves for other programs, and for the next walk."""

from __future__ import annotations

import json
import struct
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.records import DataEnd, Footer
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from quadlog.config.file import load_config
from quadlog.errors import UsageError
from quadlog.pipelines.executor.progress import Kept, Silent
from quadlog.pipelines.simulate import SimulateRequest, simulate
from quadlog.pipelines.simulation import run_folder as walk_folder
from quadlog.results.run.maps import read_ground
from quadlog.results.run.run_folder import read_metrics, read_run_json
from quadlog.results.run.tables import read_table


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("paths") / "bend.csv"
    path.write_text("x_m,y_m\n0,0\n1.0,0\n1.4,0.3\n")
    return path


def _walk(path: Path, output: Path, *settings: str, progress=None, seeds=(0,), **options) -> Path:
    config = load_config(None, ["results.frames=0", "pursuit.lookahead_m=0.6", *settings], {})
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(walk_folder, "write_plots", lambda *_: {})
        request = SimulateRequest(str(path), config, seeds, output, **options)
        return simulate(request, 1, progress or Silent())[0].run


@pytest.fixture(scope="module")
def walked(path, tmp_path_factory) -> Path:
    return _walk(path, tmp_path_factory.mktemp("runs"), "simulation.terrain=3cm")


def test_every_message_of_derived_mcap_is_what_the_tables_say(walked):
    control, paths = read_table(walked, "control"), read_table(walked, "paths")
    ticks = len(control["t_ns"])
    found = Counter()
    with (walked / "derived.mcap").open("rb") as file:
        reader = SeekingReader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            found[channel.topic] += 1
            if channel.topic == "/quadlog/resim/error":
                at = found[channel.topic] - 1
                assert message.log_time == control["t_ns"][at]
                values = [control[name][at] for name in ("error_m", "cross_track_m", "time_error_m")]
                assert [decoded.x, decoded.y, decoded.z] == values
        course, frames = (
            [decoded for *_, decoded in reader.iter_decoded_messages(topics=[topic])]
            for topic in ("/quadlog/path", "/quadlog/tf")
        )
        said = [decoded for *_, decoded in reader.iter_decoded_messages(["/quadlog/log"])]
    metrics = set(read_metrics(walked)) - {"realtime_factor"}
    assert found == {
        "/quadlog/tf": ticks,
        "/quadlog/resim/pose": ticks,
        "/quadlog/resim/error": ticks,
        "/quadlog/path": 1,
        "/quadlog/path_smooth": 1,
        "/quadlog/log": len(metrics) + len(read_run_json(walked)["warnings"]),
    }
    assert {line.message.split()[0] for line in said if line.name == "metric"} == metrics
    points = course[0].entities[0].lines[0].points
    assert [(point.x, point.y) for point in points] == list(zip(paths["x_m"], paths["y_m"], strict=True))
    assert [frame.translation.z for frame in frames] == control["z_m"].tolist()
    assert any(abs(frame.rotation.y) > 1e-4 for frame in frames)


def test_all_checksums_of_derived_mcap_hold(walked):
    content = (walked / "derived.mcap").read_bytes()
    with (walked / "derived.mcap").open("rb") as file:
        records = list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
    footer = records[-1]
    assert isinstance(footer, Footer)
    (end,) = [record for record in records if isinstance(record, DataEnd)]
    assert end.data_section_crc == zlib.crc32(content[: footer.summary_start - (1 + 8 + 4)]) != 0
    assert footer.summary_crc == zlib.crc32(content[footer.summary_start : -12]) != 0
    assert struct.unpack("<I", content[-12:-8])[0] == footer.summary_crc


def test_the_layout_shows_what_there_is(walked):
    layout = json.loads((walked / "foxglove-layout.json").read_text())
    assert "Plot!expanded" not in layout["configById"]
    assert set(layout["configById"]["3D!scene"]["topics"]) == {
        *("/quadlog/path", "/quadlog/path_smooth", "/quadlog/resim/pose"),
    }


def test_the_same_seed_gives_the_same_bytes(walked, path, tmp_path):
    again = _walk(path, tmp_path, "simulation.terrain=3cm")
    for name in ("derived.mcap", "foxglove-layout.json", "control.parquet"):
        assert (again / name).read_bytes() == (walked / name).read_bytes(), name


def test_a_walk_on_the_ground_of_another_is_that_walk(walked, path, tmp_path):
    """The ground goes through its file and is cut anew: the same within what float32 holds."""
    progress = Kept()
    again = _walk(path, tmp_path, f"simulation.terrain={walked}", progress=progress)
    assert not any("warning" in line for line in progress.lines)
    ours, theirs = read_table(again, "control"), read_table(walked, "control")
    for name in ("x_m", "y_m", "z_m", "yaw_rad"):
        count = min(len(ours[name]), len(theirs[name]), 40)
        np.testing.assert_allclose(ours[name][:count], theirs[name][:count], atol=2e-4)
    # On a plane it goes otherwise.
    plane = read_table(_walk(path, tmp_path / "flat"), "control")
    assert np.abs(plane["z_m"][:40] - theirs["z_m"][:40]).max() > 2e-3
    a, b = read_ground(again), read_ground(walked)
    both = np.round((a.origin_m - b.origin_m) / b.cell_m).astype(int)
    rows, cols = a.height_m.shape
    assert (both >= 0).all()
    np.testing.assert_array_equal(a.height_m, b.height_m[both[1] : both[1] + rows, both[0] : both[0] + cols])


def test_a_run_tells_whose_ground_it_walked_on_and_what_of_it_nobody_saw(walked, tmp_path):
    path = tmp_path / "away.csv"
    path.write_text("0,0\n0,8\n")
    progress = Kept()
    settings = (f"simulation.terrain={walked}", "simulation.controller=kinematic")
    run = _walk(path, tmp_path / "runs", *settings, progress=progress, seeds=(0, 1))
    record = read_run_json(run)
    (warning,) = record["warnings"]
    assert "lie beyond the ground that" in warning
    assert [line for line in progress.lines if "beyond" in line] == [f"warning: {warning}"]
    assert record["config"]["simulation"]["terrain"] == str(walked)
    (note,) = record["notes"]
    assert str(walked) in note
    page = (run / "report.html").read_text()
    assert "lie beyond the ground that" in page
    assert note[-65:-1] in page


def test_a_walk_is_no_terrain_for_what_replaces_it(walked, path):
    before = (walked / "ground.npz").read_bytes()
    with pytest.raises(UsageError, match="replaces it"):
        _walk(path, walked.parent.parent, f"simulation.terrain={walked}", force=True)
    assert (walked / "ground.npz").read_bytes() == before
