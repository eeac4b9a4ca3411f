from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import tomli_w

from quadlog.config.file import Flag, commented_toml, configure, load_config
from quadlog.config.schema import Anchor, Config, Tag
from quadlog.config.version import package_versions
from quadlog.errors import (
    InvalidConfigValue,
    TooLarge,
    UnknownConfigKey,
    UnknownName,
    UnreadableFile,
    UsageError,
)


def test_precedence_is_defaults_file_set(tmp_path):
    path = tmp_path / "quadlog.toml"
    path.write_text("[uwb]\nrange_std_m = 0.2\ntag_height_m = 0.7\nepoch_s = 0.1\n")
    config = load_config(path, ["uwb.epoch_s=0.3"])
    assert config.uwb.range_std_m == 0.2
    assert config.uwb.tag_height_m == 0.7
    assert config.uwb.epoch_s == 0.3
    assert config.uwb.method == Config().uwb.method


def test_nested_tables_are_reached_and_topic_names_need_no_quotes():
    settings = ["lidar.mount.z_m=0.4", "topics.lidar=/points", 'topics.uwb=["/a", "/b"]']
    config = load_config(None, settings)
    assert config.lidar.mount.z_m == 0.4
    assert (config.topics.lidar, config.topics.uwb) == (["/points"], ["/a", "/b"])


@pytest.mark.parametrize(
    ("override", "nearest"),
    [
        ("uwb.tag_heigth_m=1", "uwb.tag_height_m"),
        ("pursuit.lookahead=1", "pursuit.lookahead_m"),
        ("lidar.mount.z=1", "lidar.mount.z_m"),
        ("grids.cell_m=1", "grid"),
    ],
)
def test_unknown_keys_are_refused_with_the_nearest(override, nearest):
    with pytest.raises(UnknownConfigKey) as caught:
        load_config(None, [override])
    assert f"did you mean {nearest}" in str(caught.value)
    assert f"--set {override}" in str(caught.value)


def test_unknown_key_of_an_anchor_names_its_place_and_file(tmp_path):
    path = tmp_path / "quadlog.toml"
    path.write_text("[[uwb.anchors]]\nid = 0\nx_m = 0.0\ny = 1.0\n")
    with pytest.raises((UnknownConfigKey, InvalidConfigValue)) as caught:
        load_config(path)
    assert str(path) in str(caught.value)
    assert "uwb.anchors.0.y" in str(caught.value)


def test_values_out_of_bounds_and_unknown_presets_say_where_they_came_from():
    with pytest.raises(InvalidConfigValue, match=r"--set grid\.cell_m=-1: grid\.cell_m"):
        load_config(None, ["grid.cell_m=-1"])
    with pytest.raises(InvalidConfigValue, match="id 3 appears more than once"):
        load_config(None, ["uwb.tags=[{id=3}, {id=3}]"])
    with pytest.raises(UnknownName, match="paper"):
        load_config(preset="papers")


@pytest.mark.parametrize(
    ("content", "error"),
    [(None, UnreadableFile), (b"\xff\xfe", UnreadableFile), (b" " * ((1 << 20) + 1), TooLarge)],
)
def test_unreadable_files_are_named(tmp_path, content, error):
    path = tmp_path / "quadlog.toml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(error, match="No such file" if content is None else "not TOML|exceeds"):
        load_config(path)


def _sample() -> Config:
    return Config.model_validate(
        {
            "uwb": {
                "anchors": [Anchor(id=7, x_m=1.5, y_m=-2.0, z_m=1.2)],
                "tags": [Tag(id=1, role="person"), Tag(id=0, role="robot", height_m=0.97)],
            },
            "lidar": {"mount": {"pitch_deg": 3.0}},
        }
    )


@pytest.mark.parametrize("config", [Config(), _sample()], ids=["defaults", "sample"])
def test_a_written_configuration_reads_back_the_same(tmp_path, config):
    path = tmp_path / "quadlog.toml"
    path.write_text(commented_toml(config))
    assert load_config(path) == config


@pytest.mark.parametrize(
    ("overrides", "flags", "method", "noted"),
    [
        ([], [], "paper", True),
        (["uwb.method=weighted"], [], "weighted", False),
        ([], [Flag("--method", "uwb.method", "weighted")], "weighted", False),
        (["uwb.method=paper"], [], "paper", False),
    ],
)
def test_a_preset_overrides_only_the_file_and_reports_replaced_keys(tmp_path, overrides, flags, method, noted):
    path = tmp_path / "quadlog.toml"
    path.write_text('[uwb]\nmethod = "huber"\nsmooth = false\ncalibrate = true\nrange_std_m = 0.2\n')
    config, notes = configure(path, overrides, "paper", flags=flags)
    assert (config.uwb.method, config.uwb.calibrate, config.uwb.range_std_m) == (method, False, 0.2)
    replaced = ['uwb.method = "paper" instead of "huber"'] * noted + ["uwb.calibrate = false instead of true"]
    assert notes == (f"preset paper replaces keys of {path}: {', '.join(replaced)}",)


def test_a_model_brings_its_body_also_over_a_runs_configuration(tmp_path):
    path = tmp_path / "config.toml"
    for before in ([], ["robot.model=b1"]):
        path.write_text(tomli_w.dumps(load_config(None, before).model_dump(exclude_none=True)))
        assert load_config(path, ["robot.model=go2"]).robot.body_m == (0.69, 0.31, 0.35)
        assert load_config(path, ["robot.model=go2", "robot.length_m=0.9"]).robot.body_m == (0.9, 0.31, 0.35)
    assert Config().robot.body_m == load_config(None, ["robot.model=mine.urdf"]).robot.body_m == (0.62, 0.26, 0.37)


OF_BEFORE = """
[grid]
decay_s = 2.0
memory = "scan"
[mpc]
mu = 0.5
alpha = 1e-5
[wbc]
mu = 0.3
"""


@pytest.mark.parametrize(
    ("robot", "model", "body_m"),
    [
        ('preset = "go2"', "go2", (0.69, 0.31, 0.35)),
        ('preset = "paper"\nlength_m = 0.62\nwidth_m = 0.5', "tracking", (0.62, 0.5, 0.37)),
        ('preset = "b1"\nmodel = "mine.urdf"\nlength_m = 1.19', "mine.urdf", (0.62, 0.26, 0.37)),
    ],
)
def test_configurations_of_the_version_before_are_read_and_what_is_gone_is_named_in_a_line(
    tmp_path, robot, model, body_m
):
    path = tmp_path / "config.toml"
    path.write_text(f"{OF_BEFORE}[robot]\n{robot}\n")
    config, (note,) = configure(path)
    assert config.model_dump(exclude={"robot"}) == load_config(None, ["grid.memory=scan", "mpc.mu=0.5"]).model_dump(
        exclude={"robot"}
    )
    assert (config.robot.model, config.robot.body_m) == (model, body_m)
    assert note.startswith(f"{path}: keys of an earlier version: grid.decay_s (now ")
    assert all(each in note for each in ("robot.preset (now robot.model", "mpc.alpha (now constant)", "[wbc] (now"))


@pytest.mark.parametrize("setting", ["wbc.mu=0.3", "robot.preset=go2", "mpc.alpha=1", "simulation.trot.lateral=same"])
def test_what_is_gone_cannot_be_set_and_says_what_stands_for_it(setting):
    with pytest.raises(InvalidConfigValue, match=rf"--set {setting}: [a-z.]+: is a key of an earlier version: now "):
        load_config(None, [setting])


def test_the_versions_that_decide_results_are_those_of_all_dependencies_but_the_plumbing():
    project = tomllib.loads((Path(__file__).parents[3] / "pyproject.toml").read_text())["project"]
    names = {re.split("[>;]", each)[0] for each in project["dependencies"] if "sys_platform != 'linux'" not in each}
    plumbing = {"aiohttp", "click", "fsspec", "isal", "jinja2", "libusb-package", "lz4", "pillow", "pyyaml", "rich"}
    plumbing |= {"s3fs", "tabulate", "tomli-w", "tomlkit", "zstandard"}
    assert (names - plumbing) | {"llvmlite"} <= set(package_versions())


@pytest.mark.parametrize(
    ("key", "value", "override", "same"),
    [
        ("planner.name", "astar", "planner.name=astar", True),
        ("planner.name", "astar", "planner.name=lpa_star", False),
        ("planner.name", "astar", "planner={name='lpa_star'}", False),
        ("planner.name", "astar", "planner.memory=true", None),
        ("pursuit.speed_mps", 0.6, "pursuit.speed_mps=0.60", True),
        ("pursuit.speed_mps", 0.6, "pursuit.speed_mps=0.5", False),
    ],
)
def test_an_option_and_a_setting_of_one_key_must_agree(key, value, override, same):
    flags = [Flag("--option", key, value), Flag("--other", "planner.smooth", None)]
    if same is None:
        with pytest.raises(UnknownConfigKey):
            configure(None, [override], flags=flags)
    elif same:
        assert configure(None, [override], flags=flags).config == load_config(None, [override])
    else:
        with pytest.raises(UsageError, match=rf"--option {value} and --set {re.escape(override)} differ"):
            configure(None, [override], flags=flags)


def test_bounds_of_metrics_come_back_from_the_file_and_unknown_metrics_are_refused(tmp_path):
    path = tmp_path / "quadlog.toml"
    path.write_text("[expect]\neta_m = { max = 0.3 }\nsuccess_rate = { min = 0.99, max = 1 }\n")
    config = load_config(path, ["expect.collisions.max=0"])
    dumped = config.model_dump(exclude_none=True)["expect"]
    assert dumped == {"eta_m": {"max": 0.3}, "success_rate": {"min": 0.99, "max": 1.0}, "collisions": {"max": 0.0}}
    path.write_text(commented_toml(config))
    assert load_config(path) == config
    for wrong, said in (
        ("eta={max=1}", "unknown key expect.eta; did you mean expect.eta_m?"),
        ("eta_m={maxi=1}", "unknown key expect.eta_m.maxi; did you mean expect.eta_m.max?"),
        ("eta_m={}", "needs min, max or both"),
        ("eta_m={min=2,max=1}", "min must not be above max"),
    ):
        with pytest.raises((UnknownConfigKey, InvalidConfigValue), match=re.escape(said)):
            load_config(None, [f"expect.{wrong}"])
