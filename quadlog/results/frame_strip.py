"""plots/frames.png: pictures of the walking robot side by side, each with its instant."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from quadlog.messages import Float
from quadlog.results.files import write_whole

COLUMNS, GAP_PX = 3, 4


def write_frame_strip(run: Path, frames: NDArray[np.uint8], seconds: Float) -> None:
    """Pictures (N, height, width, 3), taken at seconds (N,) after the start, N >= 1, in rows of three."""
    height, width = frames.shape[1:3]
    columns = min(COLUMNS, len(frames))
    rows = -(-len(frames) // columns)
    sheet = Image.new("RGB", (columns * (width + GAP_PX) - GAP_PX, rows * (height + GAP_PX) - GAP_PX), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(18)
    for number, (frame, instant_s) in enumerate(zip(frames, seconds.tolist(), strict=True)):
        left, top = number % columns * (width + GAP_PX), number // columns * (height + GAP_PX)
        sheet.paste(Image.fromarray(frame), (left, top))
        draw.text((left + 8, top + 6), f"{instant_s:.2f} s", "#1a1a1a", font)
    png = io.BytesIO()
    sheet.save(png, "PNG", optimize=True)
    (run / "plots").mkdir(exist_ok=True)
    write_whole(run / "plots" / "frames.png", png.getvalue())
