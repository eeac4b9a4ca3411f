"""Which value of a message is which joint's or foot's of a quadruped: by name, by type, or as configured."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from quadlog.errors import DecodeError, UnknownJoints, set_flag
from quadlog.messages import Float, Int
from quadlog.recordings.formatting import listed

LEG_NAMES = ("FL", "FR", "RL", "RR")
JOINT_NAMES = ("hip", "thigh", "calf")
JOINTS = tuple(f"{leg}_{joint}" for leg in LEG_NAMES for joint in JOINT_NAMES)
MOST_NAMES = 1000
"""A message with more names is refused: humanoids have fewer than a hundred."""

MOST_ORDERS = 64

# The order of motors and feet in all of Unitree's messages is FR, FL, RR, RL (unitree_legged_sdk, comm.h).
UNITREE_MOTORS = (3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8)
UNITREE_FEET = (1, 0, 3, 2)

_LEG_WORDS = {
    **dict.fromkeys(("fl", "lf", "frontleft", "leftfront"), 0),
    **dict.fromkeys(("fr", "rf", "frontright", "rightfront"), 1),
    **dict.fromkeys(("rl", "lr", "hl", "lh", "bl", "lb", "rearleft", "hindleft", "leftrear", "lefthind"), 2),
    **dict.fromkeys(("rr", "hr", "rh", "br", "rb", "rearright", "hindright", "rightrear", "righthind"), 3),
}
_ENDS = {"front": 0, "fore": 0, "rear": 2, "hind": 2, "back": 2}
_SIDES = {"left": 0, "right": 1}
_JOINT_WORDS = {
    **dict.fromkeys(("haa", "hx", "abduction", "abduct", "abad", "coxa"), 0),
    **dict.fromkeys(("hfe", "hy", "thigh", "femur", "upper"), 1),
    **dict.fromkeys(("kfe", "kn", "knee", "calf", "shank", "tibia", "lower"), 2),
}
_HIP_AXES = {"roll": 0, "x": 0, "pitch": 1, "y": 1}
_OF_MACHINES = {"wheel", "shoulder", "elbow", "wrist", "arm", "gripper", "finger", "head", "neck", "waist", "torso"}
_NOT_DRIVEN = {"wheel", "foot", "toe", "ankle", "rotor", "arm", "yaw", "fixed"}
ASK_FOR_ORDER = "give all twelve, in the order FL hip, thigh, calf, then FR, RL and RR, as robot.joints"
_HIP = -1  # a hip whose axis its own name does not tell


class Order(NamedTuple):
    """Where a message has each joint: place (12,) and sign (12,) by JOINTS; feet: (4,) places, None without forces.

    left_out: names that are no leg's.
    """

    place: Int
    sign: Float
    feet: Int | None = None
    left_out: tuple[str, ...] = ()


class JointOrder:
    """Which value of a message belongs to which joint: as configured, else by name or by the message's type.

    joints: twelve names or places in the order of JOINTS, a minus before those that turn the other way; none: detected.
    feet: places of FL, FR, RL and RR among a message's foot forces. used: topic -> the order of its last message;
    refused: topic -> why joints that may be a quadruped's are not known.
    """

    def __init__(self, joints: Sequence[str] = (), feet: Sequence[int] = ()) -> None:
        self._joints, self._feet = tuple(joints), tuple(feet)
        self.used: dict[str, Order] = {}
        self.refused: dict[str, str] = {}
        self._known: dict[tuple[str | int, ...], Order] = {}

    def of_names(self, names: tuple[str, ...], topic: str) -> Order:
        """The order of a message that names its joints. Raises DecodeError, or UnknownJoints without four legs."""
        if len(names) > MOST_NAMES:
            raise DecodeError(topic, f"names {len(names)} joints; quadlog reads at most {MOST_NAMES}")
        return self._used(names, topic, self._named)

    def of_motors(self, motors: int, feet: int, topic: str) -> Order:
        """The order of a message of Unitree's with so many motors and feet. Raises DecodeError."""
        return self._used((motors, feet), topic, self._numbered)

    def _used(self, key: Any, topic: str, order_of: Callable[[Any, str], Order]) -> Order:
        if key not in self._known:
            found = order_of(key, topic)
            if len(self._known) == MOST_ORDERS:
                self._known.clear()
            self._known[key] = found
        self.used[topic] = self._known[key]
        return self._known[key]

    def _named(self, names: tuple[str, ...], topic: str) -> Order:
        try:
            order = self._configured(names, topic) if self._joints else _by_name(names, topic)
        except DecodeError as error:
            if not isinstance(error, UnknownJoints) or error.remedy:
                self.refused[topic] = error.reason
            raise
        if self._feet and max(self._feet) >= len(names):
            raise DecodeError(topic, f"has {len(names)} entries; robot.feet names place {max(self._feet)}")
        feet = np.array(self._feet) if self._feet else _feet_of(names)
        used = {*order.place.tolist(), *(() if feet is None else feet.tolist())}
        return order._replace(feet=feet, left_out=tuple(name for i, name in enumerate(names) if i not in used))

    def _numbered(self, counts: tuple[int, int], topic: str) -> Order:
        (motors, feet), order = counts, Order(np.array(UNITREE_MOTORS), np.ones(12))
        # Configured names are for a topic that names its joints; places count here.
        if self._joints and all(each.removeprefix("-").isdecimal() for each in self._joints):
            order = self._configured(tuple(map(str, range(motors))), topic)
        places = np.array(self._feet or UNITREE_FEET)
        if motors <= order.place.max() or feet <= places.max():
            raise DecodeError(topic, f"has {motors} motors and {feet} feet; see robot.joints and robot.feet")
        return order._replace(feet=places)

    def _configured(self, names: tuple[str, ...], topic: str) -> Order:
        places = {name: i for i, name in reversed(list(enumerate(names)))}
        index, sign = [], []
        for each in self._joints:
            name = each.removeprefix("-")
            place = places.get(name, int(name) if name.isdecimal() and int(name) < len(names) else None)
            if place is None:
                raise DecodeError(
                    topic, f"has no joint {name!r} of robot.joints; its joints: {listed([n[:40] for n in names], 16)}"
                )
            if names.count(names[place]) > 1:
                raise DecodeError(topic, f"names {names[place][:40]!r} twice")
            if place in index:
                raise DecodeError(topic, f"robot.joints name {names[place][:40]!r} twice")
            index.append(place)
            sign.append(-1.0 if each.startswith("-") else 1.0)
        return Order(np.array(index), np.array(sign))


def _by_name(names: tuple[str, ...], topic: str) -> Order:
    kinds = [_leg_and_joint(name) for name in names]
    if {leg for leg, _ in filter(None, kinds)} != {0, 1, 2, 3}:  # a gripper's rh_l2 is no right hind leg
        raise _no_legs(names, topic)
    told = {joint for _, joint in filter(None, kinds)}
    # Beside thighs a hip is the abduction; beside abductions it lifts the thigh.
    hip = 0 if 1 in told else 1 if 0 in told else None
    found: dict[int, int] = {}
    for i, kind in enumerate(kinds):
        if kind is None or (kind[1] == _HIP and hip is None):
            continue
        joint = 3 * kind[0] + (hip or 0 if kind[1] == _HIP else kind[1])
        if joint in found:
            raise DecodeError(topic, f"names {JOINTS[joint]} twice: {names[found[joint]][:40]}, {names[i][:40]}")
        found[joint] = i
    if not found:
        raise _no_legs(names, topic)
    missing = [name for joint, name in enumerate(JOINTS) if joint not in found]
    if missing:
        raise DecodeError(
            topic,
            f"{len(found)} of a quadruped's 12 joints are known by name; unknown: {', '.join(missing)}; its joints: "
            f"{listed([name[:40] for name in names], 16)}; {ASK_FOR_ORDER}",
        )
    return Order(np.array([found[joint] for joint in range(12)]), np.ones(12))


def _no_legs(names: tuple[str, ...], topic: str) -> UnknownJoints:
    """With a flag to fill in where twelve names may be those of legs."""
    unknown = [name for name in names if not set(_words(name)) & _OF_MACHINES]
    flag = set_flag("robot.joints", unknown[:12])
    return UnknownJoints(topic, names, f"; {ASK_FOR_ORDER}:  {flag}" if len(unknown) >= len(JOINTS) else "")


def _leg_and_joint(name: str) -> tuple[int, int] | None:
    """The leg's number and the joint's, _HIP for a bare hip; None for what is no driven joint of a leg."""
    words = _words(name)
    leg, found = _leg_of(words), set(words)
    if leg is None or found & _NOT_DRIVEN:
        return None
    axes = {_HIP_AXES[word] for word in found if word in _HIP_AXES}
    if "hip" in found:
        told = {_JOINT_WORDS[word] for word in found if word in _JOINT_WORDS} | axes
        return (leg, told.pop() if len(told) == 1 else _HIP) if len(told) < 2 else None
    joints = {_JOINT_WORDS[word] for word in found if word in _JOINT_WORDS}
    joints |= {int(word) for word in found if word in ("0", "1", "2")} if not joints else set()
    return (leg, joints.pop()) if len(joints) == 1 else None


def _words(name: str) -> list[str]:
    """`FL_hip_joint`, `LF_HAA`, `frontLeftKnee` and `FL0` in lower-case words and numbers."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z])(?=[0-9])", " ", name[:200])
    return re.findall(r"[a-z]+|[0-9]+", apart.lower())


def _leg_of(words: Sequence[str]) -> int | None:
    legs = {_LEG_WORDS[word] for word in words if word in _LEG_WORDS}
    ends = {_ENDS[word] for word in words if word in _ENDS}
    sides = {_SIDES[word] for word in words if word in _SIDES}
    if not legs and len(ends) == len(sides) == 1:
        legs = {ends.pop() + sides.pop()}
    return legs.pop() if len(legs) == 1 else None


def _feet_of(names: tuple[str, ...]) -> Int | None:
    """Some drivers add four entries `FL_foot` whose effort is the foot's force."""
    feet = {_leg_of(_words(name)): i for i, name in enumerate(names) if _words(name)[1:] == ["foot"]}
    return np.array([feet[leg] for leg in range(4)]) if {0, 1, 2, 3} <= feet.keys() else None
