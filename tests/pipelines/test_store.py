"""Results by key: whole or not at all, whoever makes them, and with all that they depend on in the key."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from quadlog.config.file import load_config
from quadlog.pipelines.store import STATE, Store, only


def fill(text: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        (folder / "a.csv").write_text(text)
        (folder / STATE).write_text(json.dumps({"state": text}))

    return write


def fail(folder: Path) -> None:
    (folder / "a.csv").write_text("half")
    raise ValueError


def never(_: Path) -> None:
    raise AssertionError


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    return tmp_path / "run"


def test_a_result_is_made_once_and_linked_into_runs_read_only(store, run):
    assert store.get("k", fill("one"), run) == store.get("k", never, run) == {"state": "one"}
    assert [path.name for path in run.iterdir()] == ["a.csv"]
    assert (run / "a.csv").samefile(store.folder / "k" / "a.csv")
    assert (run / "a.csv").stat().st_mode & 0o777 == 0o444


def test_what_fails_leaves_nothing(store, run):
    with pytest.raises(ValueError):
        store.get("k", fail, run)
    assert [*store.folder.iterdir(), *run.iterdir()] == []
    assert not store.has("k")


def test_of_two_that_need_a_result_at_a_time_one_makes_it(store, run):
    made, other = [], run.with_name("other")
    other.mkdir()

    def slowly(folder: Path) -> None:
        made.append(folder)
        time.sleep(0.2)
        fill("one")(folder)

    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(lambda each: store.get("k", slowly, each), [run, other]))
    assert (len(made), results) == (1, [{"state": "one"}] * 2)
    assert (run / "a.csv").samefile(other / "a.csv")
    assert [path.name for path in store.folder.iterdir()] == ["k"]


def test_without_locks_the_result_of_a_faster_process_is_as_good(store, run, monkeypatch):
    def flock(*_: Any) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    def slowly(folder: Path) -> None:
        fill("mine")(folder)
        (run.parent / "other").mkdir()
        Store(run.parent).get("k", fill("theirs"), run.parent / "other")

    monkeypatch.setattr(fcntl, "flock", flock)
    assert store.get("k", slowly, run) == {"state": "mine"}
    assert (run / "a.csv").read_text() == "mine"
    assert (store.folder / "k" / "a.csv").read_text() == "theirs"


@pytest.mark.parametrize("number", [errno.EPERM, errno.EXDEV, errno.EMLINK, errno.ENOTSUP])
def test_a_result_is_copied_where_links_fail(number, store, run, monkeypatch):
    def link(*_: Any) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "link", link)
    store.get("k", fill("one"), run)
    assert (run / "a.csv").read_text() == "one"
    assert (run / "a.csv").stat().st_nlink == 1


def test_what_no_run_has_is_removed_but_for_what_is_asked_to_stay(store, run):
    for key in ("of-a-run", "of-a-failed-one", "of-nobody"):
        store.get(key, fill(key), run)
    (run / "run.json").write_text(json.dumps({"results": {"plan": "of-a-run"}}))
    (run.parent / "other.txt").write_text("no run")
    store.trim({"of-a-failed-one"})
    assert sorted(path.name for path in store.folder.iterdir()) == ["of-a-failed-one", "of-a-run"]
    (run / "run.json").write_text('{"results": 3}')
    store.trim()
    assert not store.folder.exists()


def test_a_stage_is_given_the_keys_it_names_and_no_others():
    config = load_config(settings={"robot.model": "following", "grid.cell_m": 0.2}, environ={})
    part = only(config, ("grid", "grid.cell_m", "robot.model"))
    assert (part.grid, part.robot.model) == (config.grid, "following")
    assert part.robot.model_fields_set == {"model"}
    for name in ("uwb", "robot.length_m"):
        with pytest.raises(AttributeError):
            eval(f"part.{name}")
