"""A run as a film from above: frames drawn from its saved tables, as GIF, or as MP4 where ffmpeg is installed."""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from quadlog.errors import CannotWrite, MissingProgram, NotARun
from quadlog.messages import Float
from quadlog.results.player.scene import (
    CLOUD_S,
    LEGS,
    DrawnContact,
    DrawnTrack,
    Paths,
    lookahead_point,
    pose_at,
    row_at,
    scene_of,
)
from quadlog.results.plots import style
from quadlog.results.plots.layout import Pose
from quadlog.results.plots.run_data import RunData

WIDTH_PX, MOST_PX, LEAST_PX = 720, 540, 300
"""Width of a film; its map is as high as the walk is, within these."""
STRIP_PX = 28
"""Below the map: time, speed, and the names of colours."""
SHARP = 2
"""Frames are drawn so many times larger and reduced, which smooths lines."""
FPS = 10
MAX_FRAMES = 240
SPEEDS = (1, 2, 3, 4, 5, 10, 20, 50, 100, 200, 500, 1000)
MARGIN_M = 1.5
FOLLOWED_M = 16.0
"""Width of the view that follows the robot, where the whole run would show it as a dot."""
LEAST_PX_PER_M = 12.0
FEET = ((0.36, 0.62), (0.36, -0.62), (-0.36, 0.62), (-0.36, -0.62))
"""Nominal places of feet, in lengths and widths of the body: no table has their true ones."""

_PALE, _BACK, _EDGE, _COLLISION = "#c9ced6", "#f6f7f9", "#b8bec7", "#9c2f00"
Note = Callable[[str], None]
Point = tuple[float, float]


def write_gif(run: Path, part: Path, note: Note) -> None:
    """The run as an animated GIF in the file `part`. note: called with what was thinned. Raises NotARun."""
    film = Film(RunData(run))
    note(film.words)
    palette = _palette()
    frames = (frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in film.frames())
    next(frames).save(part, "GIF", save_all=True, append_images=frames, duration=1000 // FPS, loop=0, optimize=False)


def write_mp4(run: Path, part: Path, note: Note) -> None:
    """As write_gif, as MP4, by ffmpeg. Raises MissingProgram without it, CannotWrite where it fails."""
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        raise MissingProgram("ffmpeg", "--to mp4", "--to gif")
    film = Film(RunData(run))
    note(film.words)
    width, height = film.size_px
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{FPS}", "-i", "-"]
    same = ["-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact"]
    command = [ffmpeg, "-v", "error", "-y", *raw, "-pix_fmt", "yuv420p", *same, "-movflags", "+faststart", "-f", "mp4"]
    with tempfile.TemporaryFile() as said:
        with subprocess.Popen([*command, part.resolve()], stdin=subprocess.PIPE, stderr=said) as process:  # noqa: S603
            try:
                assert process.stdin is not None
                for frame in film.frames():
                    process.stdin.write(frame.tobytes())
                process.stdin.close()
            except BrokenPipeError:
                pass  # its exit code and last words follow
            except BaseException:
                process.kill()
                raise
        if process.returncode != 0:
            said.seek(0)
            words = said.read(4096).decode(errors="replace").strip().splitlines() or ["no reason given"]
            raise CannotWrite(part, f"ffmpeg failed: {words[-1]}")


class Film:
    """The frames of a run, and in `words` how much of it they show."""

    def __init__(self, data: RunData) -> None:
        """Raises NotARun for a run in which nothing moves, or damaged files."""
        scene = scene_of(data)
        if scene is None:
            raise NotARun(data.path, "has no poses to draw a film of")
        self._scene, self._data = scene, data
        long_s = scene.until_s - scene.from_s
        self.speed = next((speed for speed in SPEEDS if long_s * FPS / speed <= MAX_FRAMES), SPEEDS[-1])
        step_s = max(self.speed / FPS, long_s / MAX_FRAMES)
        self.instants_s: Float = np.append(np.arange(scene.from_s, scene.until_s - 1e-6, step_s), scene.until_s)
        film_s = len(self.instants_s) / FPS
        self.words = f"{len(self.instants_s)} frames, {film_s:.1f} s of film for {long_s:.1f} s of run"
        if scene.thinned:
            self.words += f"; thinned: {'; '.join(scene.thinned)}"
        left, right, bottom, top = scene.extent_m()
        self._scale = SHARP * WIDTH_PX / (right - left + 2 * MARGIN_M)
        map_px = min(MOST_PX, max(LEAST_PX, round((top - bottom + 2 * MARGIN_M) * self._scale / SHARP)))
        map_px += map_px % 2  # many players want even sizes
        self._scale = min(self._scale, SHARP * map_px / (top - bottom + 2 * MARGIN_M))
        self._follows = self._scale < SHARP * LEAST_PX_PER_M
        if self._follows:
            self._scale = SHARP * WIDTH_PX / FOLLOWED_M
        self._middle_m = (left + right) / 2, (bottom + top) / 2
        self._map_px = SHARP * map_px
        self.size_px = WIDTH_PX, map_px + STRIP_PX
        self._font = ImageFont.load_default(13 * SHARP)
        self._walls = self._backdrop()

    def frames(self) -> Iterator[Image.Image]:
        """RGB pictures of size_px, FPS a second."""
        return (self.frame(float(instant_s)) for instant_s in self.instants_s)

    def frame(self, instant_s: float) -> Image.Image:
        """What is where at an instant."""
        scene = self._scene
        poses = [pose_at(track, instant_s) for track in scene.tracks]
        if self._follows:
            led = [pose for pose in reversed(poses) if pose is not None]
            self._middle_m = led[0][:2] if led else self._middle_m
        picture = Image.new("RGB", (SHARP * self.size_px[0], SHARP * self.size_px[1]), _BACK)
        draw = ImageDraw.Draw(picture)
        self._draw_cells(picture, draw, instant_s)
        for track in scene.tracks:
            self._line(draw, np.column_stack([track.x_m, track.y_m]), _paled(style.COLORS[track.color]), 1)
        for cloud in scene.clouds:
            if 0 <= instant_s - cloud.seconds < CLOUD_S:
                x, y = self._px(cloud.x_m, cloud.y_m)
                for px, py in zip(x.tolist(), y.tolist(), strict=True):
                    draw.rectangle((px - 1, py - 1, px + 1, py + 1), style.TARGET)
        planned = {paths.walker: _path_at(paths, instant_s) for paths in scene.paths}
        for paths in scene.paths:
            self._line(draw, planned[paths.walker], style.COLORS[paths.color], 2)
        for track, pose in zip(scene.tracks, poses, strict=True):
            if pose is not None:
                self._draw_walker(draw, track, pose, instant_s, planned.get(track.key))
        for contact in scene.contacts:
            self._draw_contact(draw, contact, instant_s)
        self._draw_strip(draw, instant_s)
        return picture.reduce(SHARP)

    def _px(self, x_m: Float, y_m: Float) -> tuple[Float, Float]:
        """Pixels of places (N,)."""
        middle_x, middle_y = self._middle_m
        x = SHARP * WIDTH_PX / 2 + (np.asarray(x_m) - middle_x) * self._scale
        return x, self._map_px / 2 - (np.asarray(y_m) - middle_y) * self._scale

    def _point(self, x_m: float, y_m: float) -> Point:
        x, y = self._px(np.array(x_m), np.array(y_m))
        return float(x), float(y)

    def _line(self, draw: ImageDraw.ImageDraw, line_m: Float, color: str, width: int) -> None:
        if len(line_m) > 1:
            x, y = self._px(line_m[:, 0], line_m[:, 1])
            draw.line(np.column_stack([x, y]).ravel().tolist(), color, SHARP * width, "curve")

    def _backdrop(self) -> tuple[Image.Image, Point, float] | None:
        """Cells that were occupied in half of the maps, with their lower-left corner and size."""
        occupancy = self._data.occupancy
        if occupancy is None:
            return None
        mask = Image.fromarray(np.nan_to_num(occupancy.share)[::-1] >= 0.5).convert("1")
        return mask, (float(occupancy.origin_m[0]), float(occupancy.origin_m[1])), occupancy.cell_m

    def _draw_cells(self, picture: Image.Image, draw: ImageDraw.ImageDraw, instant_s: float) -> None:
        if self._walls is not None:
            self._paste(picture, *self._walls, _PALE)
        for windows in self._scene.windows:
            row = row_at(windows.seconds, instant_s)
            if row < 0:
                continue
            x_m, y_m = (windows.origin_m + windows.cell[row] * windows.maps.cell_m).tolist()
            mask = Image.fromarray(windows.maps.occupied(int(windows.index[row]))[::-1]).convert("1")
            box = self._paste(picture, mask, (x_m, y_m), windows.maps.cell_m, style.BLACK)
            draw.rectangle(box, outline=_EDGE, width=SHARP)

    def _paste(
        self, picture: Image.Image, mask: Image.Image, corner_m: Point, cell_m: float, color: str
    ) -> tuple[float, float, float, float]:
        """Paint the cells of a mask, upper row first, and return its box in pixels."""
        left, bottom = self._point(*corner_m)
        wide, high = (size * cell_m * self._scale for size in mask.size)
        # Only what is in sight is scaled: pixel (x, y) shows the cell ((x - left), (y - top)) / size of a cell.
        size, top = cell_m * self._scale, bottom - high
        seen = picture.width, self._map_px
        coefficients = (1 / size, 0, -left / size, 0, 1 / size, -top / size)
        shown = mask.transform(seen, Image.Transform.AFFINE, coefficients, Image.Resampling.NEAREST)
        picture.paste(color, (0, 0), shown)
        return left, top, left + wide, bottom

    def _draw_walker(
        self, draw: ImageDraw.ImageDraw, track: DrawnTrack, pose: Pose, instant_s: float, plan: Float | None
    ) -> None:
        x_m, y_m, yaw_rad = pose
        color, (x, y) = style.COLORS[track.color], self._point(x_m, y_m)
        row = row_at(track.seconds, instant_s)
        if len(track.lookahead_m) and track.lookahead_m[row] > 0 and plan is not None and len(plan):
            aim = self._point(*lookahead_point(plan, x_m, y_m, float(track.lookahead_m[row])))
            draw.line([(x, y), aim], style.NOTE, SHARP)
            draw.circle(aim, 4 * SHARP, style.NOTE, "white")
        if not track.body or not np.isfinite(yaw_rad) or self._scene.body_m is None:
            draw.circle((x, y), 5 * SHARP, color, "white", SHARP)
            return
        turn = np.array([[np.cos(yaw_rad), np.sin(yaw_rad)], [-np.sin(yaw_rad), np.cos(yaw_rad)]])
        places = np.array([(0.5, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5), (0.0, 0.0), (0.8, 0.0), *FEET])
        at = np.column_stack(self._px(*(places * self._scene.body_m @ turn + (x_m, y_m)).T))
        corners = [(float(px), float(py)) for px, py in at]
        draw.polygon(corners[:4], _paled(color), color, 2 * SHARP)
        draw.line(corners[4:6], color, 2 * SHARP)
        if len(track.feet) and track.feet[row] >= 0:
            for leg in range(LEGS):
                stands = bool(track.feet[row] >> leg & 1)
                draw.circle(corners[6 + leg], max(4.0, 0.035 * self._scale), color if stands else _BACK, color, SHARP)

    def _draw_contact(self, draw: ImageDraw.ImageDraw, contact: DrawnContact, instant_s: float) -> None:
        x, y = self._point(contact.x_m, contact.y_m)
        now, half = contact.seconds <= instant_s <= contact.until_s + 1 / FPS * self.speed, 6 * SHARP
        color = _COLLISION if contact.collision else style.NOTE
        color = color if instant_s >= contact.seconds else _paled(color)
        for sign in (-1, 1):
            draw.line([(x - half, y - sign * half), (x + half, y + sign * half)], color, (4 if now else 2) * SHARP)
        if now:
            draw.circle((x, y), 14 * SHARP, None, color, 2 * SHARP)

    def _draw_strip(self, draw: ImageDraw.ImageDraw, instant_s: float) -> None:
        top, middle = self._map_px, self._map_px + SHARP * STRIP_PX / 2
        draw.rectangle((0, top, SHARP * WIDTH_PX, top + SHARP * STRIP_PX), "white")
        speed = f"  {self.speed}x" if self.speed > 1 else ""
        draw.text((8 * SHARP, middle), f"{instant_s:7.2f} s{speed}", style.BLACK, self._font, "lm")
        left = 130 * SHARP
        named: Sequence[DrawnTrack | Paths] = (*self._scene.tracks, *self._scene.paths)
        for each in named:
            draw.line([(left, middle), (left + 14 * SHARP, middle)], style.COLORS[each.color], 3 * SHARP)
            draw.text((left + 18 * SHARP, middle), each.label, style.BLACK, self._font, "lm")
            left += round(30 * SHARP + draw.textlength(each.label, self._font))


def _path_at(paths: Paths, instant_s: float) -> Float:
    """The path (K, 2) of that instant, empty before the first."""
    made = row_at(paths.seconds, instant_s)
    rows = slice(0, 0) if made < 0 else slice(int(paths.first[made]), int(paths.first[made + 1]))
    return np.column_stack([paths.x_m[rows], paths.y_m[rows]])


def _paled(color: str, share: float = 0.5) -> str:
    """The colour, so much of it the background's."""
    mixed = [round((1 - share) * int(color[k : k + 2], 16) + share * int(_BACK[k : k + 2], 16)) for k in (1, 3, 5)]
    return "#" + "".join(f"{each:02x}" for each in mixed)


def _palette() -> Image.Image:
    """A picture with all colours of a film, and what smoothed edges make of them."""
    plain = [_COLLISION, style.BLACK, _PALE, _EDGE, *style.COLORS.values()]
    colors = ["#ffffff", _BACK, *(_paled(color, share) for color in plain for share in (0, 0.25, 0.5, 0.75))]
    picture = Image.new("P", (1, 1))
    picture.putpalette([int(color[k : k + 2], 16) for color in colors for k in (1, 3, 5)])
    return picture
