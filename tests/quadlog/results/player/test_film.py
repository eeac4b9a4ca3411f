import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from quadlog.errors import CannotWrite, MissingProgram, NotARun
from quadlog.results.export import export_run
from quadlog.results.player.film import MAX_FRAMES, Film
from quadlog.results.plots.run_data import RunData
from quadlog.results.run.tables import TABLES, read_table, write_table

RESIM = np.array([0xCC, 0x79, 0xA7])


def _middle(frame: Image.Image) -> np.ndarray:
    """Mean place of the simulated robot's colour, in pixels, the strip of names left out."""
    pixels = np.asarray(frame.convert("RGB")).astype(int)[:-40]
    rows, columns = np.nonzero(np.abs(pixels - RESIM).max(axis=2) < 40)
    return np.array([columns.mean(), rows.mean()])


def test_a_gif_shows_the_walk_from_its_start_to_its_end(tiny_run: Path, tmp_path: Path) -> None:
    said: list[str] = []
    (path,) = export_run(tiny_run, "gif", tmp_path / "a.gif", note=said.append)
    assert said == ["41 frames, 4.1 s of film for 4.0 s of run"]
    with Image.open(path) as film:
        assert (film.format, film.n_frames, film.info["duration"]) == ("GIF", 41, 100)  # type: ignore[attr-defined]
        places = []
        for number in (2, 38):
            film.seek(number)
            places.append(_middle(film))
    right, up = (places[1] - places[0]) * (1, -1)
    assert right > 50
    assert up > 50  # a quarter circle to the left, from heading along x
    export_run(tiny_run, "gif", tmp_path / "b.gif")
    assert path.read_bytes() == (tmp_path / "b.gif").read_bytes()


def test_a_long_walk_is_played_faster(tiny_run: Path) -> None:
    poses = read_table(tiny_run, "poses")
    poses["t_ns"] = poses["t_ns"][0] + (poses["t_ns"] - poses["t_ns"][0]) * 1000
    write_table(tiny_run / "poses.parquet", TABLES["poses"], poses)
    film = Film(RunData(tiny_run))
    assert len(film.instants_s) <= MAX_FRAMES + 1
    assert film.words.startswith("196 frames, 19.6 s of film for 3900.0 s of run")


def test_a_walk_too_large_for_the_picture_is_followed(tiny_run: Path) -> None:
    poses = read_table(tiny_run, "poses") | {"x_m": np.linspace(0, 400, 40), "y_m": np.zeros(40)}
    write_table(tiny_run / "poses.parquet", TABLES["poses"], poses)
    (tiny_run / "control.parquet").unlink()
    film = Film(RunData(tiny_run))
    blue = [np.asarray(film.frame(at))[..., 2].astype(int) - np.asarray(film.frame(at))[..., 0] for at in (0.5, 3.5)]
    height, width = blue[0].shape
    for each in blue:
        assert each[height // 2 - 30 : height // 2 + 10, width // 2 - 20 : width // 2 + 20].max() > 100


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_an_mp4_has_the_same_frames(tiny_run: Path, tmp_path: Path) -> None:
    (path,) = export_run(tiny_run, "mp4", tmp_path / "a.mp4")
    decode = ["ffmpeg", "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    film = Film(RunData(tiny_run))
    pixels = np.frombuffer(subprocess.run(decode, capture_output=True, check=True).stdout, np.uint8)
    frames = pixels.reshape(-1, film.size_px[1], film.size_px[0], 3).astype(int)
    assert len(frames) == len(film.instants_s)
    drawn = np.asarray(film.frame(float(film.instants_s[20]))).astype(int)
    assert np.abs(frames[20] - drawn).mean() < 3


def test_without_ffmpeg_only_the_mp4_is_refused(
    tiny_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(MissingProgram, match=r"--to mp4 needs ffmpeg, which is not on PATH.*--to gif"):
        export_run(tiny_run, "mp4", tmp_path / "out" / "a.mp4")
    assert list((tmp_path / "out").iterdir()) == []
    fails = tmp_path / "ffmpeg"
    fails.write_text("#!/bin/sh\necho 'no such encoder' >&2\nexit 1\n")
    fails.chmod(0o755)
    with pytest.raises(CannotWrite, match="ffmpeg failed: no such encoder"):
        export_run(tiny_run, "mp4", tmp_path / "out" / "a.mp4")
    assert list((tmp_path / "out").iterdir()) == []
    export_run(tiny_run, "gif", tmp_path / "out" / "a.gif")


def test_a_run_in_which_nothing_moves_has_no_film(tiny_run: Path, tmp_path: Path) -> None:
    for name in ("poses", "target", "control"):
        (tiny_run / f"{name}.parquet").unlink()
    with pytest.raises(NotARun, match="has no poses to draw a film of"):
        export_run(tiny_run, "gif", tmp_path / "a.gif")
    assert not list(tmp_path.glob("*.gif"))
