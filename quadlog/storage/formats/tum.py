"""Trajectories as TUM text (`t x y z qx qy qz qw`), which evo reads and writes. Times stay exact."""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Iterator
from decimal import Decimal
from pathlib import Path

import numpy as np

from quadlog.errors import TooLarge, UnreadableFile
from quadlog.geometry import FARTHEST_M, poses_in_space
from quadlog.messages import Float, Int, PoseSeries
from quadlog.storage.atomic_write import write_whole

_MAX_POSES = 20_000_000
_MAX_LINE = 1000
_NS = 1_000_000_000
_W_FIRST = re.compile(r"\bq\w*w\b.*\bq\w*x\b", re.IGNORECASE)
_UNITS = {1_000_000: "ms", 1_000: "us", 1: "ns"}
_LONGEST_S = 9_000_000_000  # what int64 nanoseconds hold


def write_tum(
    path: Path,
    t_ns: Int,
    x_m: Float,
    y_m: Float,
    yaw_rad: Float,
    z_m: Float | None = None,
    tilt_rad: Float | None = None,
) -> None:
    """Poses, columns (N,) each, as `path`; tilt_rad (N, 2): roll and pitch. Raises CannotWrite.

    TUM has no sign for "unknown": a height or tilt that is NaN or None is written as zero. Rows without a finite
    position or yaw are left out.
    """
    write_tum_poses(path, t_ns, *poses_in_space(x_m, y_m, yaw_rad, z_m, tilt_rad))


def write_tum_poses(path: Path, t_ns: Int, position_m: Float, quat_xyzw: Float) -> None:
    """Positions (N, 3) and quaternions (N, 4) at t_ns (N,): seconds with nine decimals, metres, unit quaternion.

    Rows with a number that is not finite are left out. Raises CannotWrite.
    """
    pose = np.column_stack([position_m, quat_xyzw])
    whole = np.isfinite(pose).all(axis=1)
    # A float would round from 2^53 ns on.
    lines = [
        f"{Decimal(t).scaleb(-9):.9f} {' '.join(map(repr, numbers))}\n"
        for t, numbers in zip(t_ns[whole].tolist(), pose[whole].tolist(), strict=True)
    ]
    write_whole(path, "".join(lines).encode())


def read_tum(path: Path, warnings: list[str] | None = None) -> PoseSeries:
    """The poses of a TUM file; lines that start with # and empty ones are skipped, quaternions are normalised.

    Numbers may be separated by commas, and a comment may name qw before qx. Times may be Unix times in ms, us or ns,
    and lines that equal the one before are dropped, both of which is added to warnings.

    Raises UnreadableFile, naming the line, for anything that is not eight
    finite numbers, a quaternion of length zero, a position farther out than
    FARTHEST_M, or a time that does not increase; TooLarge for a file with more poses than memory should hold.
    """
    t_ns, values = array("q"), array("d")
    unit_ns, repeats = 0, 0
    w_first = False
    for number, line in bounded_lines(path, _MAX_LINE, "pose", comments=True):
        if line.lstrip().startswith("#"):
            w_first |= _W_FIRST.search(line) is not None
            continue
        try:
            time, *pose = line.replace(",", " ").split()
            row = [float(value) for value in pose]
            unit_ns = unit_ns or _unit_ns(Decimal(time))
            exact = Decimal(time) * unit_ns
            sound = len(row) == 7 and all(map(math.isfinite, row)) and any(row[3:]) and abs(exact) <= _LONGEST_S * _NS
        except (ValueError, ArithmeticError):
            sound = False
        if not sound:
            raise UnreadableFile(
                path, "is not 't x y z qx qy qz qw' with t in seconds and a quaternion of some length", number
            )
        t = int(exact.to_integral_value())
        if max(map(abs, row[:3])) > FARTHEST_M:
            raise UnreadableFile(path, f"has a position beyond {FARTHEST_M:.0e} m", number)
        if t_ns and t == t_ns[-1] and row == values[-7:].tolist():
            repeats += 1
            continue
        if t_ns and t <= t_ns[-1]:
            raise UnreadableFile(path, "time does not increase", number)
        if len(t_ns) == _MAX_POSES:
            raise TooLarge(f"{path}: poses", _MAX_POSES + 1, _MAX_POSES)
        t_ns.append(t)
        values.extend(row)
    if not t_ns:
        raise UnreadableFile(path, "holds no pose")
    if warnings is not None and unit_ns != _NS:
        warnings.append(f"{path}: its times are no seconds: they are read as {_UNITS[unit_ns]} since 1970")
    if warnings is not None and repeats:
        warnings.append(f"{path}: {repeats} of {len(t_ns) + repeats} lines equal the one before; they are dropped")
    table = np.array(values).reshape(-1, 7)
    table[:, 3:] = np.roll(table[:, 3:], -int(w_first), axis=1)
    # Scaled first, so that tiny and huge quaternions neither vanish nor overflow.
    quat = table[:, 3:] / np.abs(table[:, 3:]).max(axis=1, keepdims=True)
    return PoseSeries(np.array(t_ns, np.int64), table[:, :3], quat / np.linalg.norm(quat, axis=1, keepdims=True))


def bounded_lines(path: Path, longest: int, thing: str, comments: bool = False) -> Iterator[tuple[int, str]]:
    """Number and content of each line that is not empty and, unless those are wanted, no comment; a thing to a line.

    Raises UnreadableFile for one of more than `longest` characters.
    """
    try:
        if path.exists() and not path.is_file():  # a pipe would be waited for
            raise UnreadableFile(path, "is no regular file")
        with path.open(encoding="utf-8-sig", errors="replace") as file:
            number = 0
            while line := file.readline(longest + 1):
                number += 1
                if len(line) > longest:
                    raise UnreadableFile(path, f"is longer than any {thing}", number)
                if line.strip() and (comments or not line.lstrip().startswith("#")):
                    yield number, line
    except OSError as error:
        raise UnreadableFile(path, error.strerror or str(error)) from error


def _unit_ns(time: Decimal) -> int:
    """Of a trajectory's first time: seconds, or a smaller unit in which it is since 1970 and after 2001."""
    return next((size for size in _UNITS if 10**18 <= time * size <= _LONGEST_S * _NS), _NS)
