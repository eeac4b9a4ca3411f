"""Pictures of a simulated robot, drawn without a screen, in a process of their own.

Where MuJoCo finds no way to draw it may warn, raise or crash; none of that is to reach the walk that is drawn.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from quadlog.messages import Float

Frames = NDArray[np.uint8]
WIDTH_PX, HEIGHT_PX = 400, 300
# Elsewhere than on Linux, MuJoCo's own choice needs no screen.
BACKENDS = ("egl", "osmesa") if sys.platform == "linux" else ("",)
LONGEST_S = 120.0
# How far off the sun stands, and how much of the model's extent it draws shadows on: with less, ground far off is
# speckled with its own.
SUN_M, SHADOWED = 3.0, 6.0


class CannotDraw(Exception):
    """MuJoCo finds no way to draw without a screen here."""


def render_frames(model: mujoco.MjModel, joints: Float) -> Frames:
    """(N, HEIGHT_PX, WIDTH_PX, 3) pictures of the robot at coordinates (N, nq). Raises CannotDraw."""
    with tempfile.TemporaryDirectory(prefix="quadlog-") as scratch:
        folder = Path(scratch)
        mujoco.mj_saveModel(model, str(folder / "model.mjb"))
        np.save(folder / "joints.npy", joints)
        whys: list[str] = []
        for backend in BACKENDS:
            whys.append(_draw_elsewhere(folder, backend))
            if not whys[-1]:
                frames: Frames = np.load(folder / "frames.npy")
                return frames
    raise CannotDraw("; ".join(whys))


def _draw_elsewhere(folder: Path, backend: str) -> str:
    """Why it could not be drawn; empty when it was."""
    command = [sys.executable, "-m", __name__, str(folder)]
    try:
        done = subprocess.run(  # noqa: S603 (our own module)
            command,
            env=os.environ | {"MUJOCO_GL": backend},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=LONGEST_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"{backend}: took longer than {LONGEST_S:.0f} s"
    if done.returncode == 0 and (folder / "frames.npy").is_file():
        return ""
    said = done.stderr.decode(errors="replace").strip().splitlines()
    return f"{backend or 'MuJoCo'}: {said[-1][:120] if said else f'exit code {done.returncode}'}"


def _draw(folder: Path) -> None:
    """In the process of its own: every picture from behind the robot's right, so that all four legs show."""
    model = mujoco.MjModel.from_binary_path(str(folder / "model.mjb"))
    data, joints = mujoco.MjData(model), np.load(folder / "joints.npy")
    camera = mujoco.MjvCamera()
    camera.distance, camera.elevation = 1.5, -18.0
    # Shadows are drawn about a light's place only. Those of a light far away go along with the robot.
    suns = np.flatnonzero((model.light_bodyid == 0) & (model.light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL))
    model.vis.map.shadowclip = SHADOWED
    frames = np.empty((len(joints), HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    with mujoco.Renderer(model, HEIGHT_PX, WIDTH_PX) as renderer:
        for frame, coordinates in zip(frames, joints, strict=True):
            data.qpos[:] = coordinates
            model.light_pos[suns] = coordinates[:3] - SUN_M * model.light_dir[suns]
            mujoco.mj_forward(model, data)
            w, x, y, z = coordinates[3:7].tolist()
            yaw_rad = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
            camera.azimuth = math.degrees(yaw_rad) + 60.0
            camera.lookat[:] = coordinates[:3] - [0.0, 0.0, 0.08]
            renderer.update_scene(data, camera)
            renderer.render(out=frame)
    np.save(folder / "frames.npy", frames)


if __name__ == "__main__":
    _draw(Path(sys.argv[1]))
