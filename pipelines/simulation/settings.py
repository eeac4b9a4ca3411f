"""From the configuration to the settings of robot, controller and disturbances."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from quadlog.config import Config
from quadlog.config_control import Disturbances, Mpc, Pursuit, Wbc
from quadlog.errors import InvalidConfigValue, UnknownName
from quadlog.following.lookahead import FixedLookahead, FuzzyLookahead, FuzzySettings, LookaheadControl
from quadlog.locomotion.mpc import MpcSettings
from quadlog.locomotion.robot import ROBOTS, Robot
from quadlog.locomotion.walker import WalkerSettings
from quadlog.locomotion.wbc import WbcSettings
from quadlog.simulation.disturbances import DisturbanceSettings
from quadlog.simulation.ground import Ground
from quadlog.simulation.quadruped_model import TIMESTEP_S, QuadrupedModel, quadruped_model
from quadlog.simulation.user_model import load_user_model

MODEL_FILES = (".xml", ".mjcf", ".urdf")


def robot_model(config: Config, ground: Ground) -> QuadrupedModel:
    """The robot of [robot] model on its ground. Raises UnknownName, and what loading a user's file raises."""
    name, friction = config.robot.model, config.simulation.friction
    if name in ROBOTS:
        return quadruped_model(ROBOTS[name], ground, friction)
    if Path(name).suffix.lower() not in MODEL_FILES:
        raise UnknownName("robot", name, [*ROBOTS, f"a file ({', '.join(MODEL_FILES)})"])
    return load_user_model(Path(name), ground, friction)


def walker_settings(config: Config, robot: Robot) -> WalkerSettings:
    """Gait, MPC and whole-body control, within the robot's torque limits."""
    simulation = config.simulation
    return WalkerSettings(
        gait=simulation.gait,
        clearance_m=simulation.clearance_m,
        swing=simulation.swing,
        aside_m=simulation.swing_aside_m,
        whole_body=simulation.controller != "fpm",
        mpc_every_s=config.mpc.every_s,
        mpc=mpc_settings(config.mpc),
        wbc=replace(wbc_settings(config.wbc), torque_limit_nm=robot.torque_limit_nm),
    )


def mpc_settings(mpc: Mpc) -> MpcSettings:
    """[mpc]."""
    return MpcSettings(**mpc.model_dump(exclude={"every_s"}))


def wbc_settings(wbc: Wbc) -> WbcSettings:
    """[wbc]."""
    return WbcSettings(**wbc.model_dump())


def disturbance_settings(disturbances: Disturbances) -> DisturbanceSettings:
    """[simulation.disturbances]."""
    return DisturbanceSettings(**disturbances.model_dump())


def fuzzy_settings(pursuit: Pursuit) -> FuzzySettings:
    """[pursuit.fuzzy], about [pursuit] lookahead_m."""
    fuzzy = pursuit.fuzzy.model_dump()
    lambdas = {"lambda_v": fuzzy.pop("lambda_v_s2_per_m"), "lambda_w": fuzzy.pop("lambda_w_s")}
    return FuzzySettings(l0_m=pursuit.lookahead_m, **lambdas, **fuzzy)


def lookahead_control(config: Config) -> LookaheadControl:
    """Fuzzy for fpmw and fpm, else fixed. A new one for every walk: it remembers its last error."""
    if config.simulation.controller in ("fpmw", "fpm"):
        return FuzzyLookahead(fuzzy_settings(config.pursuit))
    return FixedLookahead(config.pursuit.lookahead_m)


def check_rate(rate_hz: float) -> None:
    """Control ticks with the simulation: every whole number of its steps. Raises InvalidConfigValue."""
    steps = 1 / (rate_hz * TIMESTEP_S)
    if round(steps) < 1 or abs(steps - round(steps)) > 1e-6 * steps:
        own_hz = round(1 / TIMESTEP_S)
        reason = f"must divide the simulation's {own_hz} Hz, as 50, 100 or {own_hz} do (got {rate_hz:g})"
        raise InvalidConfigValue("pursuit.rate_hz", reason, "simulate")
