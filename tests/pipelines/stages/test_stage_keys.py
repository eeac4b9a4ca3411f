"""What a stage's results depend on is in its key: every key of the configuration, and whatever it only names."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import BaseModel

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.config.version import package_versions
from quadlog.pipelines import store
from quadlog.pipelines.log import ingest
from quadlog.pipelines.replay import planned_keys
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.stages.control import resimulate
from quadlog.pipelines.stages.maps import filter_and_map
from quadlog.pipelines.stages.plan import replan
from quadlog.pipelines.stages.positions.position import locate

FIXTURES = Path(__file__).parents[3] / "fixtures"
STAGES = (ingest, locate, filter_and_map, replan, resimulate)
ROBOT = '<mujoco><worldbody><body name="{name}"><geom size="1"/></body></worldbody></mujoco>'
# A value beside the default for what a rule below cannot make one of.
OTHERS = {
    "topics.uwb": ["/ranges"],
    "topics.target": "fixed",
    "uwb.anchors": [{"id": 3, "x_m": 1.0, "y_m": 2.0}],
    "uwb.tags": [{"id": 0, "role": "robot"}],
    "uwb.range_topics": [{"topic": "/r", "tag": 0, "anchor": 1}],
    "planner.name": "astar",
    "robot.model": "following",
    "robot.joints": [str(joint) for joint in range(12)],
    "robot.feet": [0, 1, 2, 3],
    "pursuit.fuzzy.tables": "corrected",
    "pursuit.fuzzy.centroid": "continuous",
}


def request(config: Config | None = None, **options: object) -> ReplayRequest:
    chosen = replace(ReplayOptions(), **options)  # type: ignore[arg-type]
    return ReplayRequest(FIXTURES / "follow.mcap", Path("run"), config or load_config(environ={}), chosen)


def keys(config: Config | None = None, **options: object) -> list[str]:
    """Of `ingest`, and of each result behind it."""
    return list(dict.fromkeys(planned_keys(request(config, **options)).values()))


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


def other_value(name: str, value: object) -> object:
    """Another value that the configuration allows."""
    if name in OTHERS:
        return OTHERS[name]
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    if isinstance(value, float):
        return value * 0.99 if value else 0.01
    if isinstance(value, tuple):
        return [each * 0.99 + 0.01 for each in value]
    if value is None:
        return 1.5
    section = Config
    *path, last = name.split(".")
    for part in path:
        section = section.model_fields[part].annotation
    choices = getattr(section.model_fields[last].annotation, "__args__", None)
    return next(each for each in choices if each != value) if choices else f"{value}_x"


LEAVES = leaves(load_config(environ={}))


@pytest.mark.parametrize("name", LEAVES)
def test_another_value_of_any_key_starts_at_the_stage_that_reads_it(name):
    changed = load_config(settings={name: other_value(name, LEAVES[name])}, environ={})
    assert leaves(changed)[name] != LEAVES[name]
    readers = [
        number
        for number, stage in enumerate(STAGES)
        if any(name == told or name.startswith(f"{told}.") for told in stage.reads)
    ]
    assert readers, "a key that no stage reads decides nothing"
    assert unchanged(keys(), keys(changed)) == min(readers)


@pytest.mark.parametrize("name", ["grid.dilation_m", "robot.model", "results.cloud_samples", "lidar.mount.x_m"])
def test_some_of_them_by_hand(name):
    first = {"grid.dilation_m": 3, "robot.model": 1, "results.cloud_samples": 2, "lidar.mount.x_m": 0}
    changed = load_config(settings={name: other_value(name, LEAVES[name])}, environ={})
    assert unchanged(keys(), keys(changed)) == first[name]


@pytest.mark.parametrize("options", [{"stamp": "log"}, {"start_s": 0.0}, {"duration_s": 9.0}])
def test_another_option_starts_anew(options):
    assert unchanged(keys(), keys(**options)) == 0


def test_another_seed_starts_at_the_first_stage_that_draws_numbers():
    assert unchanged(keys(), keys(seed=1)) == 4
    paper = load_config(settings={"lidar.method": "paper"}, environ={})
    assert unchanged(keys(paper), keys(paper, seed=1)) == 2


def test_how_far_to_go_is_in_no_key_and_filter_alone_is_not_half_of_the_map():
    whole = keys()
    for until, count in (("ingest", 1), ("position", 2), ("map", 3), ("plan", 4), ("control", 5)):
        assert keys(until=until) == whole[:count]
    assert keys(until="filter")[:2] == whole[:2]
    assert keys(until="filter")[2] != whole[2]


@pytest.mark.parametrize(
    ("name", "other"),
    [("__version__", "0.0.1"), ("package_versions", lambda: {"numpy": "1.0"}), ("platform.machine", lambda: "abacus")],
)
def test_another_version_of_quadlog_of_a_package_or_of_the_machine_starts_anew(name, other, monkeypatch):
    before = keys()
    monkeypatch.setattr(f"quadlog.pipelines.store.{name}", other)
    store.versions.cache_clear()
    assert unchanged(before, keys()) == 0
    monkeypatch.undo()
    store.versions.cache_clear()


def test_the_packages_that_decide_are_among_the_versions():
    assert {"numpy", "scipy", "numba", "llvmlite", "small_gicp", "mujoco"} <= package_versions().keys()


def test_a_trajectory_that_the_configuration_names_counts_by_its_content(tmp_path):
    path = tmp_path / "poses.tum"
    config = load_config(settings={"topics.position": str(path)}, environ={})
    without = keys(config)
    path.write_text("0 0 0 0 0 0 0 1\n")
    one = keys(config)
    stamp = path.stat()
    path.write_text("0 1 0 0 0 0 0 1\n")
    os.utime(path, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert unchanged(without, one) == unchanged(one, keys(config)) == 0


@pytest.mark.parametrize("place", ["Range.msg", "uwb_msgs/Range.msg", "uwb_msgs/msg/Range.msg"])
def test_definitions_count_by_their_content_and_not_by_their_folder(tmp_path, place):
    for folder, content in (("a", "float32 range"), ("b", "float32 range"), ("c", "float64 range")):
        (tmp_path / folder / place).parent.mkdir(parents=True)
        (tmp_path / folder / place).write_text(content)
    found = [keys(msg_path=(tmp_path / folder,)) for folder in "abc"]
    assert found[0] == found[1]
    assert unchanged(found[0], found[2]) == unchanged(keys(), found[0]) == 0


def test_a_users_robot_counts_by_all_that_its_file_includes(tmp_path):
    model, included = tmp_path / "robot.xml", tmp_path / "legs.xml"
    model.write_text('<mujoco><include file="legs.xml"/></mujoco>')
    config = load_config(settings={"robot.model": str(model)}, environ={})
    included.write_text(ROBOT.format(name="a"))
    one = keys(config)
    assert keys(config) == one
    included.write_text(ROBOT.format(name="b"))
    assert unchanged(one, keys(config)) == 1  # legs of its lengths may tell the position


def test_plugins_are_in_the_keys(install):
    before = keys()
    store.versions.cache_clear()
    install(
        "greedy-planner", "1.0", {"quadlog.planners": {"greedy": "greedy:Greedy"}}, {"greedy": "class Greedy: pass"}
    )
    assert unchanged(before, keys()) == 0
    store.versions.cache_clear()
