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
    settings = ["uwb.epoch_s=0.3", "lidar.mount.z_m=0.4", "topics.lidar=/points", 'topics.uwb=["/a", "/b"]']
    config = load_config(path, settings)
    assert config.uwb.range_std_m == 0.2
    assert config.uwb.tag_height_m == 0.7
    assert config.uwb.epoch_s == 0.3
    assert config.uwb.method == Config().uwb.method
    assert config.lidar.mount.z_m == 0.4
    assert (config.topics.lidar, config.topics.uwb) == (["/points"], ["/a", "/b"])


GONE = "is a key of an earlier version: now "


@pytest.mark.parametrize(
    ("setting", "error", "said"),
    [
        ("uwb.tag_heigth_m=1", UnknownConfigKey, "did you mean uwb.tag_height_m"),
        ("pursuit.lookahead=1", UnknownConfigKey, "did you mean pursuit.lookahead_m"),
        ("lidar.mount.z=1", UnknownConfigKey, "did you mean lidar.mount.z_m"),
        ("grids.cell_m=1", UnknownConfigKey, "did you mean grid"),
        ("grid.cell_m=-1", InvalidConfigValue, "--set grid.cell_m=-1: grid.cell_m"),
        ("uwb.tags=[{id=3}, {id=3}]", InvalidConfigValue, "id 3 appears more than once"),
        ("wbc.mu=0.3", InvalidConfigValue, GONE),
        ("robot.preset=go2", InvalidConfigValue, GONE),
        ("mpc.alpha=1", InvalidConfigValue, GONE),
        ("simulation.trot.lateral=same", InvalidConfigValue, GONE),
        ("expect.eta={max=1}", UnknownConfigKey, "unknown key expect.eta; did you mean expect.eta_m?"),
        ("expect.eta_m={maxi=1}", UnknownConfigKey, "unknown key expect.eta_m.maxi; did you mean expect.eta_m.max?"),
        ("expect.eta_m={}", InvalidConfigValue, "needs min, max or both"),
        ("expect.eta_m={min=2,max=1}", InvalidConfigValue, "min must not be above max"),
    ],
)
def test_wrong_settings_are_refused_and_say_what_is_right(setting, error, said):
    with pytest.raises(error, match=re.escape(said)) as caught:
        load_config(None, [setting])
    assert f"--set {setting}" in str(caught.value)


def test_an_unknown_preset_is_refused_with_the_known_ones():
    with pytest.raises(UnknownName, match="paper"):
        load_config(preset="papers")


def test_unknown_key_of_an_anchor_names_its_place_and_file(tmp_path):
    path = tmp_path / "quadlog.toml"
    path.write_text("[[uwb.anchors]]\nid = 0\nx_m = 0.0\ny = 1.0\n")
    with pytest.raises((UnknownConfigKey, InvalidConfigValue)) as caught:
        load_config(path)
    assert str(path) in str(caught.value)
    assert "uwb.anchors.0.y" in str(caught.value)


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


def test_bounds_of_metrics_come_back_from_the_file(tmp_path):
    path = tmp_path / "quadlog.toml"
    path.write_text("[expect]\neta_m = { max = 0.3 }\nsuccess_rate = { min = 0.99, max = 1 }\n")
    config = load_config(path, ["expect.collisions.max=0"])
    dumped = config.model_dump(exclude_none=True)["expect"]
    assert dumped == {"eta_m": {"max": 0.3}, "success_rate": {"min": 0.99, "max": 1.0}, "collisions": {"max": 0.0}}
    path.write_text(commented_toml(config))
    assert load_config(path) == config
