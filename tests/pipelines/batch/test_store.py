"""Results by key: whole or not at all, with all that they depend on in the key."""

from __future__ import annotations

import errno
import json
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import pytest
from pydantic import BaseModel

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.config.version import package_versions
from quadlog.pipelines import store as module
from quadlog.pipelines.replay import planned_keys
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.stages.all_stages import FILTER_AND_MAP, INGEST, LOCATE, REPLAN, RESIMULATE
from quadlog.pipelines.store import FRESH_S, STATE, Store
from tests.pipelines.conftest import FIXTURES


def fill(text: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        (folder / "a.csv").write_text(text)
        (folder / STATE).write_text(json.dumps({"state": text}))

    return write


def taken(store: Store, run: Path, fill: Callable[[Path], None]) -> tuple[str, bool]:
    kept, was_there = store.get("k", fill, run)
    return kept["state"], was_there


@pytest.fixture
def store(tmp_path: Path) -> Store:
    return Store(tmp_path)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    return tmp_path / "run"


@pytest.mark.parametrize("number", [None, errno.EPERM, errno.EOPNOTSUPP])
def test_a_result_is_made_once_and_copied_into_runs_which_share_nothing(number, store, run, monkeypatch):
    """Also where a file system refuses modes, times, locks and shared blocks."""
    if number is not None:
        refused = Mock(side_effect=OSError(number, os.strerror(number)))
        for name in ("os.utime", "pathlib.Path.chmod", "fcntl.flock", "fcntl.ioctl"):
            monkeypatch.setattr(name, refused)
    assert taken(store, run, fill("one")) == ("one", False)
    assert [path.name for path in run.iterdir()] == ["a.csv"]
    assert (store.folder / "k" / "a.csv").stat().st_mode & 0o777 == (0o444 if number is None else 0o644)
    (run / "a.csv").write_text("mine")
    assert taken(store, run, Mock(side_effect=AssertionError)) == ("one", True)
    assert (run / "a.csv").read_text() == "one"


@pytest.mark.parametrize("name", ["a.csv", STATE])
@pytest.mark.parametrize("damaged", [b"", b"on", b"two", b"[]", b"{}", None])
def test_a_damaged_result_is_made_again(name, damaged, store, run):
    taken(store, run, fill("one"))
    path = store.folder / "k" / name
    path.unlink()
    if damaged is not None:
        path.write_bytes(damaged)
    assert store.has("k") == (name == "a.csv" and damaged == b"two")  # of the same size
    assert taken(store, run, fill("one")) == ("one", False)
    assert taken(store, run, Mock(side_effect=AssertionError)) == ("one", True)


def test_of_two_that_need_a_result_at_a_time_one_makes_it(store, run):
    made, other = [], run.with_name("other")
    other.mkdir()

    def slowly(folder: Path) -> None:
        made.append(folder)
        time.sleep(0.2)
        fill("one")(folder)

    with ThreadPoolExecutor(2) as pool:
        results = list(pool.map(lambda each: taken(store, each, slowly), [run, other]))
    assert (len(made), sorted(results)) == (1, [("one", False), ("one", True)])


def test_what_no_run_has_is_removed_but_for_what_was_not_finished_within_a_day(store, run):
    for key in ("of-a-run", "of-a-replaced-one", "of-an-interrupted-one", "of-an-older-one"):
        store.get(key, fill(key), run)
    os.utime(store.folder / "of-an-older-one", (time.time() - FRESH_S - 9,) * 2)
    (run / "run.json").write_text(json.dumps({"results": {"plan": "of-a-run"}}))
    store.settle(["of-a-run", "of-a-replaced-one"])
    store.trim()
    assert sorted(path.name for path in store.folder.iterdir()) == ["of-a-run", "of-an-interrupted-one"]
    store.get("of-a-run", fill(""), run)  # by a replay that does not finish
    (run / "run.json").write_text('{"results": 3}')
    store.trim()
    assert sorted(path.name for path in store.folder.iterdir()) == ["of-a-run", "of-an-interrupted-one"]
    store.settle(["of-a-run", "of-an-interrupted-one"])
    store.trim()
    assert not store.folder.exists()


STAGES = (INGEST, LOCATE, FILTER_AND_MAP, REPLAN, RESIMULATE)


def keys(config: Config | None = None, **options: Any) -> list[str]:
    """Of `ingest`, and of each result behind it."""
    chosen = replace(ReplayOptions(), **options)
    request = ReplayRequest(FIXTURES / "follow.mcap", Path("run"), config or load_config(), chosen)
    return list(dict.fromkeys(planned_keys(request).values()))


def unchanged(one: list[str], other: list[str]) -> int:
    """How many stages have the same key; behind the first that has another one, all have."""
    same = [a == b for a, b in zip(one, other, strict=True)]
    assert same == sorted(same, reverse=True)
    return sum(same)


def leaves(model: BaseModel, prefix: str = "") -> dict[str, object]:
    found: dict[str, object] = {}
    for name in type(model).model_fields:
        value = getattr(model, name)
        found |= leaves(value, f"{prefix}{name}.") if isinstance(value, BaseModel) else {prefix + name: value}
    return found


def test_every_key_counts_from_the_stage_that_reads_it():
    """A stage is given the keys that it names and no others; another value of one changes its result's key."""
    for name in leaves(load_config()):
        assert any(name == read or name.startswith(f"{read}.") for stage in STAGES for read in stage.reads), name
    first = {
        "grid.dilation_m=0.51": 3,
        "robot.model=following": 1,
        "results.cloud_samples=7": 2,
        "lidar.mount.x_m=1.0": 0,
    }
    for setting, count in first.items():
        assert unchanged(keys(), keys(load_config(None, [setting]))) == count


def test_options_and_seeds_start_where_they_count_and_how_far_to_go_is_in_no_key():
    whole = keys()
    for options in ({"stamp": "log"}, {"start_s": 0.0}, {"duration_s": 9.0}):
        assert unchanged(whole, keys(**options)) == 0
    assert unchanged(whole, keys(seed=1)) == 4  # the first stage that draws numbers
    paper = load_config(settings={"lidar.method": "paper"})
    assert unchanged(keys(paper), keys(paper, seed=1)) == 2
    for until, count in (("ingest", 1), ("position", 2), ("map", 3), ("plan", 4), ("control", 5)):
        assert keys(until=until) == whole[:count]
    assert (keys(until="filter")[:2], keys(until="filter")[2] == whole[2]) == (whole[:2], False)


@pytest.mark.parametrize(
    ("name", "other"),
    [("__version__", "0.0.1"), ("package_versions", lambda: {"numpy": "1.0"}), ("platform.machine", lambda: "abacus")],
)
def test_another_version_of_quadlog_of_a_package_or_of_the_machine_starts_anew(name, other, monkeypatch):
    before = keys()
    monkeypatch.setattr(f"quadlog.pipelines.store.{name}", other)
    module.versions.cache_clear()
    assert unchanged(before, keys()) == 0
    monkeypatch.undo()
    module.versions.cache_clear()
    assert {"numpy", "scipy", "numba", "llvmlite", "small_gicp", "mujoco"} <= package_versions().keys()


def test_files_and_plugins_that_the_configuration_names_count_by_their_content(tmp_path, install):
    path = tmp_path / "poses.tum"
    track = load_config(settings={"topics.position": str(path)})
    found = [keys(track)]
    for text in ("0 0 0 0 0 0 0 1\n", "0 1 0 0 0 0 0 1\n"):
        path.write_text(text)
        os.utime(path, ns=(1, 1))
        found.append(keys(track))
    assert unchanged(found[0], found[1]) == unchanged(found[1], found[2]) == 0
    model, included = tmp_path / "robot.xml", tmp_path / "legs.xml"
    model.write_text('<mujoco><include file="legs.xml"/></mujoco>')
    robot, found = load_config(settings={"robot.model": str(model)}), []
    for name in "aab":
        text = f'<mujoco><worldbody><body name="{name}"><geom size="1"/></body></worldbody></mujoco>'
        included.write_text(text)
        found.append(keys(robot))
    assert (found[0], unchanged(found[0], found[2])) == (found[1], 1)  # legs of its lengths may tell the position
    found = []
    for folder, content in (("a", "float32 range"), ("b", "float32 range"), ("c", "float64 range")):
        (tmp_path / folder / "uwb_msgs").mkdir(parents=True)
        (tmp_path / folder / "uwb_msgs/Range.msg").write_text(content)
        found.append(keys(msg_path=(tmp_path / folder,)))
    assert (found[0], unchanged(found[0], found[2]), unchanged(keys(), found[0])) == (found[1], 0, 0)
    before = keys()
    module.versions.cache_clear()
    install(
        "greedy-planner", "1.0", {"quadlog.planners": {"greedy": "greedy:Greedy"}}, {"greedy": "class Greedy: pass"}
    )
    assert unchanged(before, keys()) == 0
    module.versions.cache_clear()
