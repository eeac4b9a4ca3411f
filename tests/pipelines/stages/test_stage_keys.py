"""What a stage's results depend on is in its key: every key of the configuration, and whatever it only names."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
from pydantic import BaseModel

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.pipelines.request import ReplayOptions, ReplayRequest
from quadlog.pipelines.stages import resume as module
from quadlog.pipelines.stages.resume import stage_keys
from quadlog.pipelines.stages.stage import stages_for

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
    return ReplayRequest(Path("walk.mcap"), Path("run"), config or load_config(environ={}), chosen)


def keys(config: Config | None = None, identity: str = "one", **options: object) -> list[str]:
    return list(stage_keys(request(config, **options), identity).values())


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
        for number, stage in enumerate(stages_for("report"))
        if any(name == told or name.startswith(f"{told}.") for told in stage.reads)
    ]
    assert unchanged(keys(), keys(changed)) == min(readers, default=len(stages_for("report")))


@pytest.mark.parametrize("name", ["grid.dilation_m", "robot.model", "results.cloud_samples", "lidar.mount.x_m"])
def test_some_of_them_by_hand(name):
    first = {"grid.dilation_m": 2, "robot.model": 0, "results.cloud_samples": 1, "lidar.mount.x_m": 0}
    changed = load_config(settings={name: other_value(name, LEAVES[name])}, environ={})
    assert unchanged(keys(), keys(changed)) == first[name]


@pytest.mark.parametrize("options", [{"identity": "two"}, {"stamp": "log"}, {"start_s": 0.0}, {"duration_s": 9.0}])
def test_another_input_or_option_starts_anew(options):
    assert unchanged(keys(), keys(**options)) == 0


def test_another_seed_starts_at_the_first_stage_that_draws_numbers():
    assert unchanged(keys(), keys(seed=1)) == 3
    paper = load_config(settings={"lidar.method": "paper"}, environ={})
    assert unchanged(keys(paper), keys(paper, seed=1)) == 1


def test_how_far_to_go_is_in_no_key_and_filter_alone_is_not_half_of_the_map():
    whole = keys()
    for until, count in (("ingest", 0), ("position", 1), ("map", 2), ("plan", 3), ("control", 4)):
        assert keys(until=until) == whole[:count]
    assert keys(until="filter")[0] == whole[0]
    assert keys(until="filter")[1] != whole[1]


def test_another_version_of_quadlog_of_a_package_or_of_the_machine_starts_anew(monkeypatch):
    before = keys()
    monkeypatch.setattr(module, "__version__", "0.0.1")
    assert unchanged(before, keys()) == 0
    monkeypatch.undo()
    monkeypatch.setattr(module, "package_versions", lambda: {"numpy": "1.0"})
    assert unchanged(before, keys()) == 0
    monkeypatch.undo()
    monkeypatch.setattr(module.platform, "machine", lambda: "abacus")
    assert unchanged(before, keys()) == 0


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
    assert unchanged(one, keys(config)) == 0  # legs of its lengths may tell the position
    included.unlink()  # what cannot be read is never the same
    assert unchanged(keys(config), keys(config)) == 3
    # Nobody walks with it where no body walks.
    kinematic = load_config(settings={"robot.model": str(model), "simulation.controller": "kinematic"}, environ={})
    assert keys(kinematic) == keys(kinematic)


def test_plugins_that_may_take_part_are_in_the_keys(install):
    config = load_config(environ={})
    before = keys(config)
    planner = {"quadlog.planners": {"greedy": "greedy:Greedy"}}
    install("greedy-planner", "1.0", planner, {"greedy": "class Greedy: pass"})
    assert keys(config) == before
    greedy = load_config(settings={"planner.name": "greedy"}, environ={})
    one = keys(greedy)
    install("report-decoder", "1.0", {"quadlog.decoders": {"my_msgs/msg/Report": "report:decoder"}})
    assert unchanged(one, keys(greedy)) == 0


def test_another_version_of_the_planner_plans_anew(install, monkeypatch):
    planner = {"quadlog.planners": {"greedy": "greedy:Greedy"}}
    install("greedy-planner", "1.0", planner, {"greedy": "class Greedy: pass"})
    greedy = load_config(settings={"planner.name": "greedy"}, environ={})
    one, found = keys(greedy), module.all_plugins()
    monkeypatch.setattr(module, "all_plugins", lambda: [replace(each, version="1.1") for each in found])
    assert unchanged(one, keys(greedy)) == 2
