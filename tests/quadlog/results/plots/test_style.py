import io

import matplotlib as mpl
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from matplotlib.figure import Figure
from PIL import Image

from quadlog.results.plots import style
from quadlog.results.plots.style import to_png


def _draw() -> Figure:
    figure = style.new_figure(2.0)
    figure.subplots().plot([0, 1], [1, 0])
    return figure


def _chunks(png: bytes) -> list[bytes]:
    kinds, at = [], 8
    while at < len(png):
        kinds.append(png[at + 4 : at + 8])
        at += 12 + int.from_bytes(png[at : at + 4], "big")
    return kinds


def test_a_picture_carries_neither_date_nor_version() -> None:
    png = style.render_png(_draw)
    assert png is not None
    assert not {b"tEXt", b"iTXt", b"zTXt", b"tIME"} & set(_chunks(png))


def test_the_users_own_style_has_no_say_and_is_left_alone() -> None:
    plain = style.render_png(_draw)
    with mpl.rc_context({"axes.facecolor": "red", "font.size": 30, "savefig.dpi": 33}):
        assert style.render_png(_draw) == plain
        assert mpl.rcParams["axes.facecolor"] == "red"


@given(
    hnp.arrays(np.float64, st.integers(1, 400), elements=st.floats(-1e6, 1e6) | st.just(float("nan"))),
    st.integers(2, 60),
)
def test_a_thinned_line_is_short_and_keeps_its_ends_and_extremes(values: np.ndarray, limit: int) -> None:
    keep = style.thin_line(values, limit)
    assert len(keep) <= limit + 2
    assert np.all(np.diff(keep) > 0)
    assert keep[0] == 0
    assert keep[-1] == len(values) - 1
    if np.isfinite(values).any():
        assert np.nanmax(values[keep]) == np.nanmax(values)
        assert np.nanmin(values[keep]) == np.nanmin(values)


@given(st.integers(0, 10_000), st.integers(1, 300))
def test_thinned_points_are_spread_from_the_first_to_the_last(count: int, limit: int) -> None:
    keep = style.thin_points(count, limit)
    assert len(keep) == min(count, limit)
    assert np.all(np.diff(keep) > 0)
    if limit > 1 and count:
        assert (keep[0], keep[-1]) == (0, count - 1)


@given(hnp.arrays(np.uint8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=40).map(lambda shape: (*shape, 3))))
def test_pillow_reads_back_every_pixel(rgb: np.ndarray) -> None:
    with Image.open(io.BytesIO(to_png(rgb))) as picture:
        picture.load()  # checks every checksum
        assert picture.mode == "RGB"
        assert picture.info == {}
        assert np.array_equal(np.asarray(picture), rgb)
