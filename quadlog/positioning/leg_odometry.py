"""Leg odometry: where a body went by its own joints, because a foot that stands does not slip.

Feet are weighted, never switched: by how sure it is that a foot carries (its force, or what its joints' torques push
with) and by how still it stands under the motion that all feet show together (the idea of [OCELOT]). A ball-shaped foot
rolls over its point of contact: with a radius of 2 cm, that would cost 5 % of the way.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from quadlog.geometry import roll_pitch_from_quat, seconds_since, turned, yaw_from_quat
from quadlog.messages import Float, ImuSeries, Int, JointSeries

MAX_GAP_S = 0.1
"""Joints that are silent for longer say nothing of the motion meanwhile."""
HOLD_S = 0.3
"""So long without a foot on the ground the body is taken to go on at its speed; a leap of a trot is shorter."""
FEWEST_CONTACT = 0.2
"""Of the sum of the feet's weights; below it no foot stands."""
STILL_MPS = 0.08
"""A foot that moves as fast against the ground counts half."""
SMOOTHED_S = 0.08
CARRIES_SHARE, CARRIES_WIDTH = 0.3, 0.06
"""Of a foot's usual load: where it counts half, and how steep."""
MOST_SWINGING, LEAST_STANDING = 0.7, 0.2
"""Share of the time for which no gait lifts a foot; least share of a foot's greatest load when it stands."""
LIFTED_M, LIFTED_WIDTH_M, LOWEST_S = 0.03, 0.008, 1.0
"""Without forces: a foot so high above the lowest one counts half; by torques, above its own lowest place too."""
ROUNDS = 4
MOST_ROWS = 1 << 16


@dataclass(frozen=True, slots=True)
class LegGeometry:
    """Legs FL, FR, RL, RR: hips_m (4, 3) of their first axes in the body; lengths_m: aside, thigh, calf."""

    hips_m: Float
    lengths_m: tuple[float, float, float]
    foot_radius_m: float


class ContactSource(IntEnum):
    """How stance of a foot is detected."""

    FORCE = 0
    TORQUE = 1
    HEIGHT = 2  # the lowest feet, on even ground


class AttitudeSource(IntEnum):
    """Source of the body's attitude."""

    IMU = 0
    GYRO = 1
    FEET = 2  # yaw alone, from two standing feet at a time


@dataclass(frozen=True, slots=True)
class LegTrack:
    """Poses of the body: t_ns (N,); position_m (N, 3) from the first one on; rpy_rad (N, 3), z is up.

    velocity_mps: (N, 3) along the heading, to its left and up. contact: (N, 4) in 0..1 how surely each foot carries;
    standing (N,) whether one that carries is still. attitude: what turned the body; contact_sources (4,): the one used
    most for each foot. unheld_s: the longest time without a foot on the ground, but for steps longer than MAX_GAP_S.
    slipping_share: of the time in which feet carry, how much they move against the ground.
    """

    t_ns: Int
    position_m: Float
    rpy_rad: Float
    velocity_mps: Float
    contact: Float
    standing: NDArray[np.bool_]
    attitude: AttitudeSource
    contact_sources: tuple[ContactSource, ...]
    unheld_s: float
    slipping_share: float

    def __len__(self) -> int:
        return len(self.t_ns)


def leg_track(joints: JointSeries, geometry: LegGeometry, imu: ImuSeries | None = None) -> LegTrack:
    """The track of the body that these joints moved; imu: in the body's axes, None where there is none.

    An attitude is used as it is given. Without one the body is taken to be level, and yaw is the integral of its rate;
    without an IMU it comes from the feet. Rows with NaN angles say nothing of their leg.
    """
    rpy_rad, attitude = _attitude(joints.t_ns, imu)
    carries, sources = _carrying(joints, geometry, rpy_rad)
    n, t_s = len(joints), seconds_since(joints.t_ns, int(joints.t_ns[0]) if len(joints) else 0)
    step_s, still = np.diff(t_s), np.zeros((n, 3))
    track = LegTrack(joints.t_ns, still, rpy_rad, still, carries, np.zeros(n, np.bool_), attitude, sources, 0.0, 0.0)
    if n < 2:
        return track
    parts = []
    for first in range(0, n - 1, MOST_ROWS):
        last = min(first + MOST_ROWS, n - 1)
        low, high = np.searchsorted(t_s, [t_s[first] - ROUNDS * SMOOTHED_S, t_s[last] + ROUNDS * SMOOTHED_S]).tolist()
        high = min(high, n - 1)
        rows = slice(low, high + 1)
        part = _steps(joints.position_rad[rows], geometry, rpy_rad[rows], carries[rows], step_s[low:high], attitude)
        parts.append([each[first - low : last - low] for each in part])
    return _summed(track, step_s, *(np.concatenate(each) for each in zip(*parts, strict=True)))


def _feet(position_rad: Float, geometry: LegGeometry) -> tuple[Float, Float]:
    """(N, 4, 3) centres of the feet in the body, of joints (N, 12) as JointStates has them, and (N, 4, 3, 3) slopes."""
    hip, thigh, calf = np.moveaxis(position_rad.astype(np.float64).reshape(-1, 4, 3), 2, 0)
    aside, upper, lower = geometry.lengths_m
    cos, sin, y_m = np.cos(hip), np.sin(hip), aside * np.array([1.0, -1.0, 1.0, -1.0])
    calf_x, calf_down = -lower * np.sin(thigh + calf), lower * np.cos(thigh + calf)
    x_m, down_m = calf_x - upper * np.sin(thigh), calf_down + upper * np.cos(thigh)
    foot = x_m, y_m * cos + down_m * sin, y_m * sin - down_m * cos
    slopes = [0 * cos, -foot[2], foot[1]], [-down_m, x_m * sin, -x_m * cos], [-calf_down, calf_x * sin, -calf_x * cos]
    return np.stack(foot, axis=-1) + geometry.hips_m, np.array(slopes).transpose(2, 3, 1, 0)


def _levelled(vectors: Float, rpy_rad: Float) -> Float:
    """Vectors (N, 4, 3) in the body, along its heading, to its left and up."""
    (roll, pitch), (x, y, z) = rpy_rad.T[:2, :, None], np.moveaxis(vectors, -1, 0)
    y, z = np.cos(roll) * y - np.sin(roll) * z, np.sin(roll) * y + np.cos(roll) * z
    return np.stack([np.cos(pitch) * x + np.sin(pitch) * z, y, np.cos(pitch) * z - np.sin(pitch) * x], axis=-1)


def _attitude(t_ns: Int, imu: ImuSeries | None) -> tuple[Float, AttitudeSource]:
    """(N, 3) roll, pitch and unwrapped yaw at instants (N,), and the sensor that measured them."""
    if imu is None or len(imu) < 2 or len(t_ns) == 0:
        return np.zeros((len(t_ns), 3)), AttitudeSource.FEET
    start_ns = int(imu.t_ns[0])
    imu_s, t_s = seconds_since(imu.t_ns, start_ns), seconds_since(t_ns, start_ns)
    given = imu.quat_xyzw
    if given is not None and (np.abs(given).max(axis=1) > 0).all() and np.ptp(given, axis=0).any():
        quat = given / np.linalg.norm(given, axis=1, keepdims=True)
        rpy = np.column_stack([roll_pitch_from_quat(quat), np.unwrap(yaw_from_quat(quat))])
        source = AttitudeSource.IMU
    else:
        turn_rad = np.nan_to_num(imu.angular_radps[:, 2]) * np.diff(imu_s, prepend=imu_s[0])
        rpy = np.column_stack([np.zeros((len(imu), 2)), np.cumsum(turn_rad)])
        source = AttitudeSource.GYRO
    return np.column_stack([np.interp(t_s, imu_s, each) for each in rpy.T]), source


def _carrying(joints: JointSeries, geometry: LegGeometry, rpy_rad: Float) -> tuple[Float, tuple[ContactSource, ...]]:
    """(N, 4) in 0..1 how sure it is that a foot carries, and by which sensor, for each foot."""
    from scipy.ndimage import minimum_filter1d  # slow to import
    from scipy.special import expit

    carries, load_n, below_m = np.empty((3, len(joints), 4))
    sources = [ContactSource.HEIGHT] * 4
    for first in range(0, len(joints), MOST_ROWS):
        rows = slice(first, first + MOST_ROWS)
        feet_m, jacobian = _feet(joints.position_rad[rows], geometry)
        height_m = _levelled(feet_m, rpy_rad[rows])[..., 2]
        load_n[rows] = _loads(jacobian, joints.torque_nm[rows], rpy_rad[rows])
        lifted_m = height_m - np.fmin.reduce(height_m, axis=1, keepdims=True)
        carries[rows] = expit((LIFTED_M - lifted_m) / LIFTED_WIDTH_M)
        below_m[rows] = feet_m[..., 2]
    lasted_s = float((joints.t_ns[-1:] - joints.t_ns[:1]).sum()) * 1e-9
    within = max(round(len(joints) * LOWEST_S / max(lasted_s, LOWEST_S)), 1)
    lifted_m = below_m - minimum_filter1d(np.where(np.isfinite(below_m), below_m, np.inf), within, axis=0)
    low = np.maximum(carries, expit((LIFTED_M - lifted_m) / LIFTED_WIDTH_M))
    for kind, load in ((ContactSource.TORQUE, load_n), (ContactSource.FORCE, joints.foot_force_n)):
        share = share_of_usual(load)
        known: NDArray[np.bool_] = np.isfinite(share)
        carries[known] = expit((share[known] - CARRIES_SHARE) / CARRIES_WIDTH)
        if kind is ContactSource.TORQUE:  # a leg that swings needs torques too
            carries[known] *= low[known]
        sources = [kind if 2 * n > len(known) else each for each, n in zip(sources, known.sum(axis=0), strict=True)]
    carries[~np.isfinite(joints.position_rad).reshape(-1, 4, 3).all(axis=2) | ~np.isfinite(carries)] = 0.0
    return carries, tuple(sources)


def _loads(jacobian: Float, torque_nm: Float, rpy_rad: Float) -> Float:
    """(N, 4) what the feet push down with, in N, of legs without mass: tau = J^T f."""
    torques = torque_nm.reshape(-1, 4, 3, 1)
    known = np.isfinite(jacobian.sum(axis=(2, 3)) + torques.sum(axis=(2, 3)))[..., None, None]
    jacobian, torques = np.where(known, jacobian, np.eye(3)), np.where(known, torques, np.nan)
    # A stretched leg holds any force along itself; damping by 1 mm keeps the solution finite.
    damped = jacobian @ np.swapaxes(jacobian, 2, 3) + 1e-6 * np.eye(3)
    force_n = np.linalg.solve(damped, jacobian @ torques)[..., 0]
    return -_levelled(force_n, rpy_rad)[..., 2]


def share_of_usual(load: Float) -> Float:
    """Loads (N, F) of any unit as shares of each foot's own usual ones, NaN where they say nothing."""
    share = np.full(load.shape, np.nan)
    for foot, column in enumerate(load.T):
        known = np.isfinite(column)
        if not known.any():
            continue
        low, middle, high = np.percentile(column[known], [5.0, 50.0, 95.0])
        # A foot that stands all the time is never without load: then its sensor's zero is taken to be right.
        low = low if low < high / 2 else 0.0
        if high > max(low, 0.0):
            share[:, foot] = (column - low) / (high - low)
            # Of a robot that mostly stood the low load is that of standing, which is half of a trot's.
            if middle > LEAST_STANDING * high and (share[known, foot] < CARRIES_SHARE).mean() > MOST_SWINGING:
                share[:, foot] = column / (2 * middle)
    return share


def _steps(
    position_rad: Float, geometry: LegGeometry, rpy_rad: Float, carries: Float, step_s: Float, attitude: AttitudeSource
) -> tuple[Float, Float, Float, Float]:
    """Way (M, 3) in the heading of the first of two instants, turn (M,); weight and stillness of the feet (M, 4)."""
    feet_m = _levelled(_feet(position_rad, geometry)[0], rpy_rad)
    rolled_m = _rolled(position_rad, geometry.foot_radius_m, rpy_rad)
    known = np.isfinite(feet_m[1:] + feet_m[:-1]).all(axis=2) & (step_s <= MAX_GAP_S)[:, None]
    before, after = (np.where(known[..., None], each, 0.0) for each in (feet_m[:-1], feet_m[1:]))
    rolled_m = np.where(known[..., None], rolled_m, 0.0)
    firm = np.where(known, np.minimum(carries[1:], carries[:-1]), 0.0)
    weight, turn_rad = firm, np.diff(rpy_rad[:, 2])
    for turn in range(ROUNDS):
        if attitude is AttitudeSource.FEET:
            turn_rad = _turn_of_feet(before + rolled_m, after, weight)
        moves_m = before + rolled_m - turned(turn_rad, after)
        if turn < ROUNDS - 1:
            still = _stillness(moves_m, weight, step_s)
            weight = firm * still
    total = weight.sum(axis=1)
    move_m = (weight[..., None] * moves_m).sum(axis=1) / np.maximum(total, 1e-9)[:, None]
    return move_m, turn_rad, weight, still


def _stillness(moves_m: Float, weight: Float, step_s: Float) -> Float:
    """(M, 4) in 0..1: how well the motion that each foot shows (M, 4, 3) fits that of all of them, over a while."""
    way_m, lasted_s = (weight[..., None] * moves_m).sum(axis=1), weight.sum(axis=1) * step_s
    velocity_mps = _around(way_m, step_s, SMOOTHED_S) / np.maximum(_around(lasted_s, step_s, SMOOTHED_S), 1e-9)[:, None]
    off_m = _around(moves_m - velocity_mps[:, None] * step_s[:, None, None], step_s, SMOOTHED_S / 4)
    off_mps = off_m / np.maximum(_around(step_s, step_s, SMOOTHED_S / 4), 1e-9)[:, None, None]
    return 1.0 / (1.0 + np.einsum("ijk,ijk->ij", off_mps, off_mps) / STILL_MPS**2)


def _around(values: Float, step_s: Float, within_s: float) -> Float:
    """Sums of values (M, ...) over the steps of these durations (M,) whose middles lie so close around each one's."""
    middle_s = np.cumsum(step_s) - step_s / 2
    begin, end = (np.searchsorted(middle_s, middle_s + sign * (within_s / 2 + 1e-6)) for sign in (-1, 1))
    summed = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    return summed[end] - summed[begin]


def _rolled(position_rad: Float, radius_m: float, rpy_rad: Float) -> Float:
    """(M, 4, 3) how far the centre of each foot rolls on the ground between instants (M + 1,): rotation x radius."""
    hip, thigh, calf = np.moveaxis(position_rad.astype(np.float64).reshape(-1, 4, 3), 2, 0)
    roll, pitch = rpy_rad[:, :1], rpy_rad[:, 1:2]
    bent, about, tilt = np.diff(thigh + calf, axis=0), *((each[1:] + each[:-1]) / 2 for each in (roll + hip, pitch))
    about_y = np.diff(pitch, axis=0) + bent * np.cos(about)
    about_x = np.diff(roll + hip, axis=0) * np.cos(tilt) + bent * np.sin(tilt) * np.sin(about)
    return radius_m * np.stack([about_y, -about_x, np.zeros_like(about_x)], axis=-1)


def _turn_of_feet(before: Float, after: Float, weight: Float) -> Float:
    """(M,) yaw that turns the feet after a step (M, 4, 3) onto those before it, by least squares [Umeyama]."""
    first, last = before[..., 0] + 1j * before[..., 1], after[..., 0] + 1j * after[..., 1]
    centre = (weight * first).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-9)
    return np.angle((weight * (first - centre[:, None]) * np.conj(last)).sum(axis=1))


def _summed(track: LegTrack, step_s: Float, move_m: Float, turn_rad: Float, weight: Float, still: Float) -> LegTrack:
    """A track with the steps added up; while no foot stands the body goes on as before, for HOLD_S at most."""
    stands, ends_s = weight.sum(axis=1) >= FEWEST_CONTACT, np.cumsum(step_s)
    # Over the last SMOOTHED_S of standing: what one short step shows is noise.
    stood_s, *stood_m = np.cumsum(np.where(stands, np.column_stack([step_s, move_m]).T, 0.0), axis=1)
    begin_s = np.maximum(stood_s - SMOOTHED_S, 0.0)
    began_m = np.column_stack([np.interp(begin_s, stood_s, each) for each in stood_m])
    velocity_mps = (np.column_stack(stood_m) - began_m) / SMOOTHED_S
    last = np.maximum.accumulate(np.where(stands, np.arange(len(stands)), -1))
    unheld_s = ends_s - np.where(last >= 0, ends_s[last], 0.0)
    velocity_mps = np.where((last >= 0)[:, None] & (unheld_s <= HOLD_S)[:, None], velocity_mps[last], 0.0)
    move_m = np.where(stands[:, None], move_m, velocity_mps * step_s[:, None])
    yaw_rad = track.rpy_rad[:, 2]
    if track.attitude is AttitudeSource.FEET:
        yaw_rad = np.append(0.0, np.cumsum(np.where(stands, turn_rad, 0.0)))
    firm, heard_s = np.minimum(track.contact[1:], track.contact[:-1]) > 0.5, np.cumsum(step_s * (step_s <= MAX_GAP_S))
    guessed, sure = np.equal(track.contact_sources, ContactSource.HEIGHT), np.concatenate([weight, weight[-1:]])
    return replace(
        track,
        contact=np.where(guessed, sure, track.contact),
        position_m=np.concatenate([np.zeros((1, 3)), np.cumsum(turned(yaw_rad[:-1], move_m), axis=0)]),
        rpy_rad=np.column_stack([track.rpy_rad[:, :2], yaw_rad]),
        velocity_mps=np.concatenate([velocity_mps, velocity_mps[-1:]]),
        standing=np.append(stands, stands[-1]),
        unheld_s=float((heard_s - np.where(last >= 0, heard_s[last], 0.0)).max()),
        slipping_share=float(step_s @ ((still < 0.5) & firm).sum(axis=1) / max(step_s @ firm.sum(axis=1), 1e-9)),
    )
