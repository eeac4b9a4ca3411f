"""plots/*.png and report.html of one run, from its saved results only."""

from __future__ import annotations

import base64
import io
import shlex
from collections.abc import Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from quadlog.errors import CannotWrite
from quadlog.messages import Float
from quadlog.results.page.body import body_tables
from quadlog.results.page.charts import run_charts, to_script_json
from quadlog.results.page.html import render_page
from quadlog.results.page.metric_cards import metric_themes
from quadlog.results.page.player import player_of
from quadlog.results.page.verdict import verdict
from quadlog.results.plots.figures import PLOTS, SharedDrawing, render_plots
from quadlog.results.plots.run_data import RunData
from quadlog.results.run.record import RunRecord
from quadlog.results.run.stages import STAGES
from quadlog.storage.atomic_write import write_whole

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


_MAX_CONFIG_CHARS = 1_000_000
_MAX_FRAMES_BYTES = 64 << 20
_PNG = b"\x89PNG\r\n\x1a\n"
_MAX_CONTACTS = 100
_SIMULATED_STAGES = ("control", "report")
_CHART_SCRIPTS = ("vendor/uPlot.iife.min.js", "charts.js", "time_charts.js", "map_chart.js")
_PLAYER_SCRIPTS = ("player_scene.js", "player_view.js", "player.js")
_SEARCH_SCRIPTS = ("search.js",)
_CHART_STYLES = ("vendor/uPlot.min.css",)


def write_report(run: Path, helper: Executor | None = None) -> Path:
    """Write plots/ and report.html of a finished run, and return the latter's path. The same files, the same bytes.

    helper: a process that draws some of the figures. Raises NotARun for an unfinished or damaged run, CannotWrite.
    """
    data = RunData(run)
    drawing = SharedDrawing(data, helper)
    charts, player = run_charts(data), player_of(data)
    pictures = drawing.finish()
    _write_plots(run / "plots", pictures)
    return _write_page(data, pictures, charts, player)


def write_plots(run: Path, record: RunRecord | None = None) -> dict[str, bytes]:
    """Draw every figure whose data the run has, as plots/NAME.png, and return them by name.

    record: of a run that is not finished, whose run.json is written last; default: read from run.json. Pictures of an
    earlier report whose data is gone are removed. Raises NotARun, CannotWrite.
    """
    pictures = render_plots(RunData(run, record))
    _write_plots(run / "plots", pictures)
    return pictures


def write_page(run: Path, pictures: Mapping[str, bytes], record: RunRecord | None = None) -> Path:
    """report.html around the pictures of write_plots; record as there. Raises NotARun, CannotWrite."""
    data = RunData(run, record)
    return _write_page(data, pictures, run_charts(data), player_of(data))


def _write_page(
    data: RunData, pictures: Mapping[str, bytes], charts: Mapping[str, Any], player: Mapping[str, Any] | None
) -> Path:
    report = data.path / "report.html"
    shown = {name: charts[name] for name in pictures if name in charts}
    write_whole(report, _render(data, pictures, shown, player))
    return report


def _write_plots(folder: Path, pictures: Mapping[str, bytes]) -> None:
    if folder.is_symlink():
        raise CannotWrite(folder, "is a link; pictures are not written through it")
    try:
        folder.mkdir(exist_ok=True)
        for plot in PLOTS:
            if plot.name not in pictures:
                (folder / f"{plot.name}.png").unlink(missing_ok=True)
    except OSError as error:
        raise CannotWrite(folder, error.strerror or str(error)) from error
    for name, png in pictures.items():
        write_whole(folder / f"{name}.png", png)


def _render(
    data: RunData, pictures: Mapping[str, bytes], charts: Mapping[str, Any], player: Mapping[str, Any] | None
) -> bytes:
    record = data.record
    done = {stage.name for stage in record.stages} | {"report"}
    return render_page(
        "report.html.jinja",
        **moving_parts(charts, player, bool(data.metrics)),
        title=run_title(data),
        verdict=verdict(data),
        themes=metric_themes(data),
        record=record,
        arrived=_arrived(data),
        left_out=data.left_out(),
        simulated=data.simulated,
        stages=[{"name": name, "done": name in done} for name in (_SIMULATED_STAGES if data.simulated else STAGES)],
        total_s=sum(stage.seconds for stage in record.stages),
        links=_links(data),
        **_contacts(data),
        body=body_tables(data),
        plots=[
            *_frames(data.path),
            *(
                _picture(plot.name, plot.title, plot.alt, *plot.captions(data), pictures[plot.name])
                for plot in PLOTS
                if plot.name in pictures
            ),
        ],
        command=shlex.join(str(word) for word in record.command),
        config=_config_text(data.path),
    )


def moving_parts(charts: Mapping[str, Any], player: Mapping[str, Any] | None, searches: bool) -> dict[str, Any]:
    """Scripts, styles and data of a page with charts, a player, and a table of metrics to search in."""
    drawn = bool(charts or player)
    return {
        "scripts": (*_CHART_SCRIPTS * drawn, *_PLAYER_SCRIPTS * (player is not None), *_SEARCH_SCRIPTS * searches),
        "styles": _CHART_STYLES * drawn,
        "player": player,
        "player_data": Markup(to_script_json(player)),  # noqa: S704
        "charts": charts,
        "chart_data": Markup(to_script_json(charts)),  # noqa: S704
    }


def run_title(data: RunData) -> str:
    """Name of the recording, from a path of any system; of a simulated walk: course, controller and seed."""
    record = data.record
    name = record.input.path.replace("\\", "/").rstrip("/").rsplit("/", 1)[-1] or data.path.name
    return f"{name}, {record.options.get('controller')}, seed {record.seed}" if data.simulated else name


def _arrived(data: RunData) -> bool | None:
    """Whether a simulated robot reached the end of its course; None where there is none to reach."""
    if not data.simulated or data.metric("eta_m") is None:
        return None
    return data.metric("completion_time_s") is not None


def _frames(run: Path) -> list[dict[str, Any]]:
    """The pictures of a simulated robot, which were drawn during the simulation and cannot be drawn again."""
    path = run / "plots" / "frames.png"
    if not path.is_file() or path.stat().st_size > _MAX_FRAMES_BYTES:
        return []
    png = path.read_bytes()
    if not png.startswith(_PNG) or len(png) < 24:
        return []
    alt = "Pictures of the simulated robot at some instants of its walk, side by side."
    caption = "The simulated robot, seconds after its start."
    return [_picture("frames", "The walk", alt, caption, caption, png)]


def _links(data: RunData) -> list[dict[str, Any]]:
    """Rows of links.parquet; a number that a link does not have is None."""
    links = data.table("links") or {}
    rows = zip(*(column.tolist() for column in links.values()), strict=True)
    return [{name: None if value != value else value for name, value in zip(links, row, strict=True)} for row in rows]


def _contacts(data: RunData) -> dict[str, Any]:
    """The first rows of contacts.parquet, in seconds since the start of the run, as in charts, and how many more."""
    contacts = data.table("contacts")
    if contacts is None:
        return {"contacts": [], "contacts_left_out": 0}
    timed = contacts | {"from_s": data.seconds(contacts["t_ns"])}
    columns = {name: column[:_MAX_CONTACTS].tolist() for name, column in timed.items()}
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    return {"contacts": rows, "contacts_left_out": len(contacts["t_ns"]) - len(rows)}


def _picture(name: str, title: str, alt: str, caption: str, chart_caption: str, png: bytes) -> dict[str, Any]:
    """Template values of a PNG; its header holds width and height at bytes 16 to 24."""
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    encoded = base64.b64encode(png).decode()
    return {
        "name": name,
        "title": title,
        "alt": alt,
        "caption": caption,
        "chart_caption": chart_caption,
        "png": encoded,
        "width": width,
        "height": height,
    }


def _config_text(run: Path) -> str:
    path = run / "config.toml"
    if not path.is_file():
        return ""
    with path.open(encoding="utf-8", errors="replace") as file:
        return file.read(_MAX_CONFIG_CHARS)
