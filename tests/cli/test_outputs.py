"""What a command is asked to write never takes the place of a run's own file, a FIFO, a device or a link."""

from __future__ import annotations

import os
import shutil
import stat
from pathlib import Path

import pytest

from quadlog.errors import CannotWrite
from quadlog.storage.atomic_write import write_whole

FIXTURES = Path(__file__).parents[2] / "fixtures"
COMMANDS = {
    "export tum": "export RUN --to tum -o OUT",
    "export mcap": "export RUN --to mcap -o OUT",
    "export gif": "export RUN --to gif -o OUT",
    "check --write": "check RUN --expect OUT --write",
    "check --junit": "check RUN --expect bounds.toml --junit OUT",
    "init": "init LOG -o OUT",
    "survey": "survey LOG -o OUT",
    "synthesize": "synthesize follow --format mcap -o OUT",
    "synthesize --config-output": "synthesize follow -o new.mcap --config-output OUT",
    "report": "report RUN RUN --side-by-side -o OUT",
}


@pytest.fixture
def run(follow, tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return shutil.copytree(follow, tmp_path / "run")


def words(command: str, run: Path, out: Path | str) -> list[str]:
    given = {"RUN": run, "LOG": FIXTURES / "follow.mcap", "OUT": out}
    return [str(given.get(word, word)) for word in COMMANDS[command].split()]


@pytest.mark.parametrize("force", [[], ["--force"]], ids=["", "force"])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_file_of_a_run_is_no_output(command, force, run, refused):
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    for name in ("run.json", "poses.parquet", "plots/trajectory.png"):
        assert "is a file of the run" in refused(2, *words(command, run, run / name), *force)
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(("to", "folder"), [("rosmap", "RUN"), ("csv", "tables")])
def test_what_goes_into_a_folder_spares_runs_and_pipes_too(to, folder, run, refused, tmp_path):
    (tmp_path / "tables").mkdir()
    os.mkfifo(tmp_path / "tables" / "scans.csv")
    refused(2 if to == "rosmap" else 1, "export", run, "--to", to, "-o", run if to == "rosmap" else folder, "--force")
    assert [path.name for path in (tmp_path / "tables").iterdir()] == ["scans.csv"]


@pytest.mark.parametrize("command", COMMANDS)
def test_force_replaces_no_pipe_and_no_link(command, run, refused, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/null")
    for name, why in (("pipe", "it is no regular file"), ("link", "it is a link")):
        assert why in refused(1, *words(command, run, name), "--force")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert (tmp_path / "link").is_symlink()


def test_no_file_at_all_is_written_over_a_pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "stdout").symlink_to("pipe")
    for name in ("pipe", "stdout"):
        with pytest.raises(CannotWrite, match="it is no regular file"):
            write_whole(tmp_path / name, b"")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["pipe", "stdout"]
