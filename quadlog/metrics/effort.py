"""What a walk cost the robot's joints, and how well it kept its posture."""

from __future__ import annotations

from dataclasses import dataclass

from quadlog.metrics.metric import Metric, Metrics

JOINTS = 12
GRAVITY_MPS2 = 9.81


@dataclass(frozen=True, slots=True)
class Effort:
    """Over all ticks: the joints' energy and the way walked, the largest torque, and the share of torques cut.

    pitch_rms_rad, height_rms_m: of the body's tilt and height beside those that the ground under its feet asks for.
    """

    energy_j: float
    distance_m: float
    torque_max_nm: float
    saturation_share: float
    pitch_rms_rad: float
    height_rms_m: float


def effort_metrics(
    mass_kg: float,
    ticks: int,
    energy_j: float,
    distance_m: float,
    torque_max_nm: float,
    saturation_share: float,
    pitch_rms_rad: float,
    height_rms_m: float,
) -> Metrics:
    """pitch_rms_rad, height_rms_m, torque_max_nm, torque_saturation_share and cost_of_transport; none without ticks.

    Over all ticks of the simulation: pitch and height against what the controller wanted, which follows the ground;
    saturation_share of all joints at all ticks; energy_j is the sum of |torque x joint speed|, so that braking costs as
    much as driving, and is given per weight and distance_m walked.
    """
    if ticks == 0:
        return {}
    metrics = {
        "pitch_rms_rad": Metric(pitch_rms_rad, ticks, "rad"),
        "height_rms_m": Metric(height_rms_m, ticks, "m"),
        "torque_max_nm": Metric(torque_max_nm, ticks * JOINTS, "N·m"),
        "torque_saturation_share": Metric(saturation_share, ticks * JOINTS, ""),
    }
    if distance_m > 0:
        metrics["cost_of_transport"] = Metric(energy_j / (mass_kg * GRAVITY_MPS2 * distance_m), ticks, "")
    return metrics
