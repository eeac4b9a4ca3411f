"""Commands as a user gives them, in this process, on recordings that a case has made."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from quadlog.cli.main import run as run_cli
from quadlog.results.record import is_finished
from quadlog.results.tables import read_table


@dataclass(frozen=True)
class Replayed:
    """What a user gets from `quadlog replay`: the exit code, stderr, and the run folder."""

    code: int
    err: str
    run: Path

    @property
    def record(self) -> dict[str, Any]:
        return json.loads((self.run / "run.json").read_text())

    @property
    def metrics(self) -> dict[str, Any]:
        return json.loads((self.run / "metrics.json").read_text())

    @property
    def warned(self) -> list[str]:
        return self.record["warnings"]

    @property
    def said(self) -> str:
        return "\n".join(self.record["warnings"] + self.record["notes"])

    def table(self, name: str) -> dict[str, Any]:
        return read_table(self.run, name)

    def sources(self, table: str = "poses") -> set[str]:
        return set(self.table(table)["source"])


@pytest.fixture
def replayed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Replayed]:
    """Replays into a new folder, with a configuration as text; where the exit code says so, the run is finished."""
    count = iter(range(100))

    def go(recording: Path, *flags: str, config: str = "") -> Replayed:
        (tmp_path / "quadlog.toml").write_text(config)
        runs = tmp_path / f"runs{next(count)}"
        words = ["replay", str(recording), "-o", str(runs), "--no-plots", "-v", "-c", str(tmp_path / "quadlog.toml")]
        capsys.readouterr()
        code = run_cli([*words, *flags])
        err = capsys.readouterr().err
        assert "Traceback" not in err
        run = runs / recording.stem
        assert is_finished(run) == (code in (0, 3))
        return Replayed(code, err, run)

    return go


@pytest.fixture
def described(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., dict[str, Any]]:
    """What `info --json` prints; it never fails for what is in the recording."""

    def go(recording: Path, config: str = "") -> dict[str, Any]:
        (tmp_path / "quadlog.toml").write_text(config)
        capsys.readouterr()
        assert run_cli(["info", str(recording), "-c", str(tmp_path / "quadlog.toml"), "--json"]) in (0, 3)
        done = capsys.readouterr()
        assert "Traceback" not in done.err
        return json.loads(done.out)

    return go
