"""One short replay of the committed recording, shared by the tests that only look at it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from quadlog.config_file import load_config
from quadlog.pipelines.progress import Silent
from quadlog.pipelines.replay import ReplayOptions, ReplayOutcome, ReplayRequest, replay

FIXTURES = Path(__file__).parents[2] / "fixtures"
SHORT_S = 3.0


def fixture_request(run: Path, **options: object) -> ReplayRequest:
    """The committed recording's first seconds, into the folder `run`."""
    config = load_config(FIXTURES / "follow.toml", environ={})
    chosen = replace(ReplayOptions(duration_s=SHORT_S), **options)  # type: ignore[arg-type]
    return ReplayRequest(FIXTURES / "follow.mcap", run, config, chosen)


@pytest.fixture(scope="session")
def fixtures() -> Path:
    """Where the committed recording is."""
    return FIXTURES


@pytest.fixture(scope="session")
def follow_request() -> Callable[..., ReplayRequest]:
    """Makes requests to replay the committed recording's first seconds into a folder."""
    return fixture_request


@pytest.fixture(scope="session")
def short_run(tmp_path_factory: pytest.TempPathFactory) -> ReplayOutcome:
    return replay(fixture_request(tmp_path_factory.mktemp("runs") / "follow"), Silent())


@pytest.fixture(scope="session")
def whole_run(tmp_path_factory: pytest.TempPathFactory) -> ReplayOutcome:
    request = fixture_request(tmp_path_factory.mktemp("runs") / "follow", duration_s=None)
    return replay(request, Silent())
