from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import Writer

from quadlog.cli.main import run
from quadlog.config.file import load_config


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "walk.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("gtec_msgs/msg/Ranging", "ros2msg", b"")
        channel = writer.register_channel("/gtec", "cdr", schema)
        payload = b"\0\1\0\0" + b"".join(n.to_bytes(4, "little") for n in (4, 1, 2500, 0)) + bytes(16)
        writer.add_message(channel, 10**9, payload, 10**9)
        writer.finish()
    return path


def test_writes_a_config_that_loads(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(["init", str(recording)]) == 0
    assert capsys.readouterr().out == "quadlog.toml\n"
    assert load_config(Path("quadlog.toml")).topics.uwb == ["/gtec"]
    text = Path("quadlog.toml").read_text()
    assert "# id = 4\n" in text
    assert "# id = 1\n" in text


def test_refuses_to_overwrite(recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("keep")
    assert run(["init", str(recording), "-o", str(path)]) == 1
    assert "--force" in capsys.readouterr().err
    assert path.read_text() == "keep"
    assert run(["init", str(recording), "-o", str(path), "--force"]) == 0
    assert path.read_text() != "keep"


def test_a_damaged_recording_is_told_as_info_tells_it(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording.write_bytes(recording.read_bytes()[:-30])
    assert run(["info", str(recording)]) == 3
    told = capsys.readouterr().err
    assert "lost: " in told
    output = tmp_path / "new.toml"
    assert run(["init", str(recording), "-o", str(output)]) == 3
    out, err = capsys.readouterr()
    assert (out, err) == (f"{output}\n", told)
    assert load_config(output).topics.uwb == ["/gtec"]
