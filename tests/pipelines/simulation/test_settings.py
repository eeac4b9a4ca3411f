"""Defaults stand in two places, for the configuration must not load the controllers: they are the same."""

from __future__ import annotations

from dataclasses import fields

import pytest

from quadlog.config.control import DisturbancesConfig
from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.control.following.lookahead import FixedLookahead, FuzzyLookahead, FuzzySettings
from quadlog.control.locomotion.gait import GAITS
from quadlog.control.locomotion.mpc import MpcSettings
from quadlog.control.locomotion.robot import ROBOTS
from quadlog.control.locomotion.walker import WalkerSettings
from quadlog.control.locomotion.wbc import WbcSettings
from quadlog.errors import InvalidConfigValue
from quadlog.pipelines.simulate import DISTURBED_OVERRIDES
from quadlog.pipelines.simulation import walk as settings
from quadlog.simulation.robot.disturbances import DISTURBED, NONE
from quadlog.simulation.robot.height_field import FRICTION

ROBOT = ROBOTS["tracking"]


def test_the_defaults_are_those_of_the_settings():
    config = Config()
    assert settings.mpc_settings(config.mpc) == MpcSettings()
    assert settings.wbc_settings(config.wbc) == WbcSettings()
    assert settings.fuzzy_settings(config.pursuit) == FuzzySettings()
    assert settings.disturbance_settings(config.simulation.disturbances) == NONE
    assert settings.walker_settings(config, ROBOT) == WalkerSettings()
    assert config.simulation.friction == FRICTION
    assert config.robot.model in ROBOTS


def test_every_gait_can_be_chosen():
    for gait in GAITS:
        assert load_config(None, [f"simulation.gait={gait}"], {}).simulation.gait == gait


def test_disturbed_is_what_the_simulation_means_by_it():
    config = load_config(None, list(DISTURBED_OVERRIDES), {})
    assert settings.disturbance_settings(config.simulation.disturbances) == DISTURBED
    assert set(DisturbancesConfig.model_fields) == {field.name for field in fields(DISTURBED)}


def test_controllers_differ_in_look_ahead_and_whole_body_control():
    for name, fuzzy, whole_body in (("fpmw", True, True), ("fpm", True, False), ("pmw", False, True)):
        config = load_config(None, [f"simulation.controller={name}"], {})
        assert isinstance(settings.lookahead_control(config), FuzzyLookahead if fuzzy else FixedLookahead)
        assert settings.walker_settings(config, ROBOT).whole_body == whole_body


def test_the_turning_share_is_the_configurations():
    config = load_config(None, ["mpc.turning_share=0.3"], {})
    assert settings.walker_settings(config, ROBOT).turning_share == 0.3


def test_torque_limits_are_the_robots():
    assert settings.walker_settings(Config(), ROBOTS["following"]).wbc.torque_limit_nm == 48.0


@pytest.mark.parametrize(
    "override", ["mpc.f_min_n=200", "wbc.f_min_n=200", "pursuit.fuzzy.l_min_m=6", "mpc.weight_rpy=[1, 2]", "mpc.mu=0"]
)
def test_settings_that_no_controller_takes_are_refused_by_name(override):
    with pytest.raises(InvalidConfigValue, match=override.split("=")[0].rsplit(".", 1)[0].replace(".", r"\.")):
        load_config(None, [override], {})


@pytest.mark.parametrize("rate_hz", [1, 50, 100, 125, 250, 500])
def test_rates_that_divide_the_simulations_are_taken(rate_hz):
    settings.check_rate(rate_hz)


@pytest.mark.parametrize("rate_hz", [60, 300, 499, 1000])
def test_other_rates_are_refused(rate_hz):
    with pytest.raises(InvalidConfigValue, match="must divide"):
        settings.check_rate(rate_hz)


def test_every_key_of_the_fuzzy_rules_arrives_where_it_belongs():
    overrides = {
        "lambda_v_s2_per_m": 4.0,
        "lambda_w_s": 0.5,
        "k_v0": 0.1,
        "k_w0": 0.2,
        "gain_e_per_m": 20.0,
        "gain_ec_s_per_m": 0.6,
        "signed": True,
        "ec_filter_s": 0.3,
        "l_min_m": 0.4,
        "l_max_m": 3.0,
        "tables": "corrected",
        "centroid": "continuous",
    }
    given = [f"pursuit.fuzzy.{key}={str(value).lower()}" for key, value in overrides.items()]
    config = load_config(None, ["pursuit.lookahead_m=1.5", *given], {})
    assert settings.fuzzy_settings(config.pursuit) == FuzzySettings(
        1.5, 4.0, 0.5, 0.1, 0.2, 20.0, 0.6, True, 0.3, 0.4, 3.0, "corrected", "continuous"
    )
