"""How a foot moves with every joint above it: a chain of hinges from the trunk on.

The same as MuJoCo's mj_jacSite and mj_jacDot times qvel, which cost eight calls a tick and several times as long.
"""

from __future__ import annotations

from quadlog.compiled import inner


@inner
def foot_motion(position, rotation, qvel, first, joints, anchors, axes, foot, jacobian, rate):  # type: ignore[no-untyped-def]
    """Writes a foot's Jacobian (3, 18) and rate (3,), the change of the Jacobian times qvel.

    position (3,) and rotation (3, 3) of the trunk, qvel (18,) as `locomotion.wbc` has it. joints (3,): from the trunk
    down, which of anchors (J, 3) and axes (J, 3), in map; first: where in qvel they begin. foot (3,) in map.
    """
    point, end = _vector(position), _vector(foot)
    omega, alpha, acceleration = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for axis in range(3):
        along = rotation[0, axis], rotation[1, axis], rotation[2, axis]
        jacobian[axis, axis] = 1.0
        _put(_cross(along, _minus(end, point)), jacobian, 3 + axis)
        omega = _plus(omega, _times(qvel[3 + axis], along))
    # While qvel is constant, so is the trunk's velocity in map, and its angular velocity: what it changes by is itself.
    for k in range(3):
        anchor, along = _vector(anchors[joints[k]]), _vector(axes[joints[k]])
        _put(_cross(along, _minus(end, anchor)), jacobian, first + k)
        acceleration = _plus(acceleration, _carried(omega, alpha, _minus(anchor, point)))
        turn = _times(qvel[first + k], along)
        alpha, omega, point = _plus(alpha, _cross(omega, turn)), _plus(omega, turn), anchor
    acceleration = _plus(acceleration, _carried(omega, alpha, _minus(end, point)))
    rate[0], rate[1], rate[2] = acceleration


@inner
def _carried(omega, alpha, arm):  # type: ignore[no-untyped-def]
    """How the end of an arm that turns is accelerated beside its beginning."""
    return _plus(_cross(alpha, arm), _cross(omega, _cross(omega, arm)))


@inner
def _vector(array):  # type: ignore[no-untyped-def]
    return array[0], array[1], array[2]


@inner
def _put(vector, matrix, column):  # type: ignore[no-untyped-def]
    matrix[0, column], matrix[1, column], matrix[2, column] = vector


@inner
def _plus(a, b):  # type: ignore[no-untyped-def]
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inner
def _minus(a, b):  # type: ignore[no-untyped-def]
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inner
def _times(factor, a):  # type: ignore[no-untyped-def]
    return factor * a[0], factor * a[1], factor * a[2]


@inner
def _cross(a, b):  # type: ignore[no-untyped-def]
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
