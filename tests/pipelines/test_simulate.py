from __future__ import annotations

import json
import re
import struct
import zlib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import SeekingReader
from mcap.records import DataEnd, Footer
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

from quadlog.config.file import load_config
from quadlog.errors import (
    AlreadyExists,
    InvalidConfigValue,
    TooLarge,
    TooSteep,
    UnknownName,
    UnreadableFile,
    UsageError,
)
from quadlog.pipelines import simulate as walk_folder
from quadlog.pipelines.executor.progress import Kept, Silent
from quadlog.pipelines.report import rebuild_reports
from quadlog.pipelines.simulate import DISTURBED_OVERRIDES, SimulatedRun, SimulateRequest, simulate
from quadlog.results.arrays import read_arrays
from quadlog.results.record import read_metrics
from quadlog.results.tables import read_table


@pytest.fixture(scope="module")
def path(tmp_path_factory) -> Path:
    """A metre straight on and half a metre aside."""
    path = tmp_path_factory.mktemp("paths") / "bend.csv"
    path.write_text("x_m,y_m\n0,0\n1.0,0\n1.4,0.3\n")
    return path


def _request(path: Path | str, output: Path, *settings: str, **options) -> SimulateRequest:
    config = load_config(None, ["pursuit.lookahead_m=0.6", *settings], {})
    return SimulateRequest(str(path), config, output=output, **options)


def _simulate(request: SimulateRequest) -> SimulatedRun:
    (run,) = simulate(request, 1, Silent())
    return run


@pytest.fixture
def undrawn(monkeypatch) -> None:
    """Without plots, which take longer than the walk."""
    monkeypatch.setattr(walk_folder, "write_plots", lambda *_: {})


def test_an_interrupted_walk_leaves_no_folder_in_the_way(path, tmp_path, monkeypatch):
    """A walk cannot be resumed, so the same command must work again without --force."""

    def interrupted(*_):
        raise KeyboardInterrupt

    request = _request(path, tmp_path / "runs", "simulation.controller=kinematic")
    monkeypatch.setattr(walk_folder, "write_run_page", interrupted)
    monkeypatch.setattr(walk_folder, "write_plots", lambda *_: {})
    with pytest.raises(KeyboardInterrupt):
        simulate(request, 1, Silent())
    assert not [each for each in tmp_path.rglob("*") if each.is_file()]
    monkeypatch.setattr(walk_folder, "write_run_page", lambda *_: None)
    assert (_simulate(request).run / "run.json").is_file()


@pytest.fixture(scope="module")
def walked(path, once) -> SimulatedRun:
    return once("simulated", lambda runs: _simulate(_request(path, runs, "simulation.terrain=3cm")))


def test_a_run_folder_has_what_the_contract_promises(walked):
    assert walked.run.parts[-2:] == ("bend-fpmw", "seed-000")
    names = {entry.name for entry in walked.run.iterdir()}
    assert {"run.json", "config.toml", "metrics.json", "control.parquet", "report.html", "plots"} <= names
    assert {entry.stem for entry in (walked.run / "plots").iterdir()} == {"trajectory", "tracking_error"}
    control = read_table(walked.run, "control")
    # Along a course nothing is planned.
    assert np.isnan(control.pop("plan_error_m")).all()
    assert all(np.isfinite(column).all() for column in control.values())
    record = json.loads((walked.run / "run.json").read_text())
    assert record["seed"] == 0
    assert record["counts"]["ticks"] == len(control["t_ns"])
    assert record["counts"]["mpc_solved"] > 50
    assert record["counts"]["wbc_solved"] > 500
    assert not record.get("warnings")


def test_metrics_are_those_of_the_table(walked):
    control = read_table(walked.run, "control")
    metrics = {name: metric["value"] for name, metric in read_metrics(walked.run).items()}
    assert metrics["eta_m"] == pytest.approx(control["error_m"].mean())
    assert metrics["sigma_m"] == pytest.approx(control["error_m"].std(ddof=1))
    assert metrics["eta_time_m"] == pytest.approx(control["time_error_m"].mean())
    assert metrics["max_error_m"] == control["error_m"].max()
    assert metrics["cross_track_rmse_m"] == pytest.approx(np.sqrt((control["cross_track_m"] ** 2).mean()))
    assert metrics["completion_time_s"] == pytest.approx(control["t_ns"][-1] * 1e-9)
    assert metrics["fallen"] == 0
    assert metrics["torque_max_nm"] >= max(np.abs(control[f"tau_{k:02d}_nm"]).max() for k in range(12))
    assert 0 <= metrics["torque_saturation_share"] < 0.01
    assert 0.2 < metrics["cost_of_transport"] < 3
    assert metrics["pitch_rms_rad"] < 0.05
    assert metrics["height_rms_m"] < 0.02
    assert metrics["realtime_factor"] > 0
    assert walked.to_dict() == {
        "run": str(walked.run),
        "course": "bend",
        "controller": "fpmw",
        "seed": 0,
        **metrics,
    }


def test_the_folder_of_runs_has_a_row_for_each(walked):
    summary = read_table(walked.run.parent, "summary")
    assert summary["recording"].tolist() == ["seed-000"]
    assert summary["eta_m"][0] == walked.to_dict()["eta_m"]
    assert "seed-000" in (walked.run.parent / "report.html").read_text()


def test_the_written_config_gives_the_same_walk(walked, path, tmp_path, undrawn):
    config = load_config(walked.run / "config.toml", [], {})
    again = _simulate(SimulateRequest(str(path), config, output=tmp_path))
    for name in (
        "control.parquet",
        "config.toml",
        "paths.parquet",
        "ground.npz",
        "derived.mcap",
        "foxglove-layout.json",
    ):
        assert (again.run / name).read_bytes() == (walked.run / name).read_bytes(), name


def test_the_page_speaks_of_a_simulation_and_can_be_made_again(walked):
    page = (walked.run / "report.html").read_bytes()
    text = page.decode()
    assert "bend.csv, fpmw, seed 0" in text
    assert "The simulated robot walked" in text
    assert "Recorded walk" not in text
    assert list(rebuild_reports([walked.run])) == [walked.run / "report.html"]
    assert (walked.run / "report.html").read_bytes() == page


@pytest.mark.nightly
def test_seeds_draw_their_own_ground_and_many_processes_give_the_same(path, tmp_path, undrawn):
    request = _request(path, tmp_path / "one", "simulation.terrain=6cm", *DISTURBED_OVERRIDES, seeds=(3, 4))
    one = simulate(request, 1, Silent())
    two = simulate(replace(request, output=tmp_path / "two"), 2, Silent())
    assert [each.seed for each in one] == [each.seed for each in two] == [3, 4]
    control = [(each.run / "control.parquet").read_bytes() for each in (*one, *two)]
    assert control[:2] == control[2:]
    assert control[0] != control[1]
    first, second = ((each.run / "ground.npz").read_bytes() for each in one)
    assert first != second


@pytest.mark.parametrize("controller", ["fpm", "pmw", "kinematic"])
def test_other_controllers_walk_too(path, tmp_path, controller, undrawn):
    run = _simulate(_request(path, tmp_path, f"simulation.controller={controller}"))
    control = read_table(run.run, "control")
    assert run.run.parent.name == f"bend-{controller}"
    assert run.metrics["completion_time_s"]["value"] < 6
    is_fuzzy = controller == "fpm"
    assert np.isfinite(control["k_v"]).any() == is_fuzzy
    assert is_fuzzy or set(control["lookahead_m"]) == {0.6}
    has_body = controller != "kinematic"
    assert ("fallen" in run.metrics) == ("torque_max_nm" in run.metrics) == has_body
    assert "wbc_solved" not in json.loads((run.run / "run.json").read_text())["counts"] or controller == "pmw"


def test_a_fall_is_a_result(path, tmp_path, undrawn):
    strong = ("simulation.disturbances.push_n=2000", "simulation.disturbances.push_every_s=0.5")
    progress = Kept()
    (run,) = simulate(_request(path, tmp_path, *strong, "simulation.disturbances.push_s=0.3"), 1, progress)
    assert run.metrics["fallen"]["value"] == 1
    assert "completion_time_s" not in run.metrics
    assert run.ended.startswith("fell after ")
    assert json.loads((run.run / "run.json").read_text())["warnings"] == [f"the robot {run.ended}"]
    page = (run.run / "report.html").read_text()
    assert re.search(r"The simulated robot walked .* and fell at", page)
    assert read_table(run.run.parent, "summary")["exit_code"].tolist() == [0]
    assert any("fell after" in line for line in progress.lines)


def test_a_walk_stands_until_the_one_that_replaces_it_is_complete(path, tmp_path, undrawn, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    request = _request(path, tmp_path, "simulation.controller=kinematic")
    run = _simulate(request).run
    before = {each: each.read_bytes() for each in run.rglob("*") if each.is_file()}
    monkeypatch.setattr("quadlog.pipelines.simulate.write_run_page", stop)
    with pytest.raises(KeyboardInterrupt):
        _simulate(replace(request, force=True))
    assert {each: each.read_bytes() for each in run.rglob("*") if each.is_file()} == before
    assert [each.name for each in run.parent.iterdir() if each.is_dir()] == [run.name]


def test_nothing_is_overwritten_unless_forced(path, tmp_path, undrawn):
    request = _request(path, tmp_path, "simulation.controller=kinematic")
    run = _simulate(request).run
    (run / "mine.txt").touch()
    before = (run / "control.parquet").stat().st_mtime_ns
    with pytest.raises(AlreadyExists, match="use --force to replace it"):
        simulate(request, 1, Silent())
    assert (run / "control.parquet").stat().st_mtime_ns == before
    _simulate(replace(request, force=True))
    assert (run / "control.parquet").stat().st_mtime_ns > before
    assert (run / "mine.txt").exists()


@pytest.mark.parametrize(
    ("settings", "error"),
    [
        (["simulation.friction=0.05", "simulation.terrain=6cm"], TooSteep),
        (["robot.model=spot"], UnknownName),
        (["robot.model=nowhere.xml"], UnreadableFile),
        (["pursuit.rate_hz=300"], InvalidConfigValue),
        (["simulation.controller=none"], UsageError),
    ],
)
def test_what_cannot_be_walked_is_refused_before_anything_is_written(path, tmp_path, settings, error):
    with pytest.raises(error):
        simulate(_request(path, tmp_path / "runs", *settings), 1, Silent())
    assert not (tmp_path / "runs").exists()


def test_an_unknown_course_is_refused_with_those_there_are(tmp_path):
    with pytest.raises(UnknownName, match="circle, line, s-curve"):
        simulate(_request("moon", tmp_path), 1, Silent())


def test_a_path_too_long_to_walk_is_refused(tmp_path):
    path = tmp_path / "long.csv"
    path.write_text("".join(f"{19 * k},0\n" for k in range(10_000)))
    with pytest.raises(TooLarge, match="ticks of a walk"):
        simulate(_request(path, tmp_path), 1, Silent())


def test_a_path_of_its_own_name_has_its_own_ground(tmp_path, undrawn):
    """A file called s-curve.csv is not the s-curve."""
    path = tmp_path / "s-curve.csv"
    path.write_text("0,0\n0.5,0\n")
    run = _simulate(_request(path, tmp_path, "simulation.controller=kinematic"))
    assert not (run.run / "ground.npz").exists()


def test_the_s_curve_brings_its_ground_and_its_speed_unless_told_otherwise(tmp_path, undrawn):
    run = _simulate(_request("s-curve", tmp_path, "simulation.controller=kinematic"))
    assert (run.run / "ground.npz").exists()
    assert json.loads((run.run / "run.json").read_text())["config"]["pursuit"]["speed_mps"] == 0.5
    flat = ("simulation.terrain=flat", "pursuit.speed_mps=0.7")
    faster = _simulate(_request("s-curve", tmp_path / "flat", "simulation.controller=kinematic", *flat))
    assert not (faster.run / "ground.npz").exists()
    assert faster.metrics["completion_time_s"]["value"] < run.metrics["completion_time_s"]["value"]


def test_json_is_plain(walked):
    assert json.loads(json.dumps(walked.to_dict(), allow_nan=False)) == walked.to_dict()


def test_every_message_of_derived_mcap_is_what_the_tables_say(walked):
    control, paths = read_table(walked.run, "control"), read_table(walked.run, "paths")
    ticks = len(control["t_ns"])
    found = Counter()
    with (walked.run / "derived.mcap").open("rb") as file:
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
    metrics = set(read_metrics(walked.run)) - {"realtime_factor"}
    assert found == {
        "/quadlog/tf": ticks,
        "/quadlog/resim/pose": ticks,
        "/quadlog/resim/error": ticks,
        "/quadlog/resim/command": ticks,
        "/quadlog/path": 1,
        "/quadlog/path_smooth": 1,
        "/quadlog/log": len(metrics) + len(json.loads((walked.run / "run.json").read_text())["warnings"]),
    }
    assert {line.message.split()[0] for line in said if line.name == "metric"} == metrics
    points = course[0].entities[0].lines[0].points
    assert [(point.x, point.y) for point in points] == list(zip(paths["x_m"], paths["y_m"], strict=True))
    assert [frame.translation.z for frame in frames] == control["z_m"].tolist()
    assert any(abs(frame.rotation.y) > 1e-4 for frame in frames)


def test_all_checksums_of_derived_mcap_hold(walked):
    content = (walked.run / "derived.mcap").read_bytes()
    with (walked.run / "derived.mcap").open("rb") as file:
        records = list(StreamReader(file, emit_chunks=True, validate_crcs=True).records)
    footer = records[-1]
    assert isinstance(footer, Footer)
    (end,) = [record for record in records if isinstance(record, DataEnd)]
    assert end.data_section_crc == zlib.crc32(content[: footer.summary_start - (1 + 8 + 4)]) != 0
    assert footer.summary_crc == zlib.crc32(content[footer.summary_start : -12]) != 0
    assert struct.unpack("<I", content[-12:-8])[0] == footer.summary_crc


def test_a_walk_on_the_ground_of_another_is_that_walk(walked, path, tmp_path, undrawn):
    """The ground goes through its file and is cut anew: the same within what float32 holds."""
    (again,) = simulate(_request(path, tmp_path, f"simulation.terrain={walked.run}"), 1, progress := Kept())
    assert not any("warning" in line for line in progress.lines)
    ours, theirs = read_table(again.run, "control"), read_table(walked.run, "control")
    for name in ("x_m", "y_m", "z_m", "yaw_rad"):
        count = min(len(ours[name]), len(theirs[name]), 40)
        np.testing.assert_allclose(ours[name][:count], theirs[name][:count], atol=2e-4)
    # On a plane it goes otherwise.
    plane = read_table(_simulate(_request(path, tmp_path / "flat")).run, "control")
    assert np.abs(plane["z_m"][:40] - theirs["z_m"][:40]).max() > 2e-3
    a, b = read_arrays(again.run, "ground"), read_arrays(walked.run, "ground")
    both = np.round((a["origin_m"] - b["origin_m"]) / b["cell_m"]).astype(int)
    rows, cols = a["height_m"].shape
    assert (both >= 0).all()
    same = b["height_m"][both[1] : both[1] + rows, both[0] : both[0] + cols]
    np.testing.assert_array_equal(a["height_m"], same)


def test_a_run_tells_whose_ground_it_walked_on_and_what_of_it_nobody_saw(walked, tmp_path, undrawn):
    path = tmp_path / "away.csv"
    path.write_text("0,0\n0,8\n")
    settings = (f"simulation.terrain={walked.run}", "simulation.controller=kinematic")
    run = simulate(_request(path, tmp_path / "runs", *settings, seeds=(0, 1)), 1, progress := Kept())[0].run
    record = json.loads((run / "run.json").read_text())
    (warning,) = record["warnings"]
    assert "lie beyond the ground that" in warning
    assert [line for line in progress.lines if "beyond" in line] == [f"warning: {warning}"]
    assert record["config"]["simulation"]["terrain"] == str(walked.run)
    (note,) = record["notes"]
    assert str(walked.run) in note
    page = (run / "report.html").read_text()
    assert "lie beyond the ground that" in page
    assert note[-65:-1] in page


def test_a_walk_is_no_terrain_for_what_replaces_it(walked, path):
    before = (walked.run / "ground.npz").read_bytes()
    with pytest.raises(UsageError, match="replaces it"):
        _simulate(_request(path, walked.run.parent.parent, f"simulation.terrain={walked.run}", force=True))
    assert (walked.run / "ground.npz").read_bytes() == before
