import io

import numpy as np
from hypothesis import given
from hypothesis.extra import numpy as hnp
from PIL import Image

from quadlog.results.plots.style import to_png


@given(hnp.arrays(np.uint8, hnp.array_shapes(min_dims=2, max_dims=2, max_side=40).map(lambda shape: (*shape, 3))))
def test_pillow_reads_back_every_pixel(rgb: np.ndarray) -> None:
    with Image.open(io.BytesIO(to_png(rgb))) as picture:
        picture.load()  # checks every checksum
        assert picture.mode == "RGB"
        assert picture.info == {}
        assert np.array_equal(np.asarray(picture), rgb)
