from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from quadlog.metrics.alignment import find_frame_offset, frame_offset_words, mirror_words


def walk(n: int = 200, noise_m: float = 0.05, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A track with noise, and the truth."""
    phase = np.linspace(0, 4 * np.pi, n)
    truth = np.stack([4 + 3 * np.sin(phase), 3 + 2 * np.cos(phase / 2)], axis=1)
    return truth + noise_m * np.random.default_rng(seed).standard_normal((n, 2)), truth


def moved(points: np.ndarray, turn_rad: float, shift_m) -> np.ndarray:
    turned = Rotation.from_euler("z", turn_rad).apply(np.column_stack([points, np.zeros(len(points))]))[:, :2]
    return turned + np.asarray(shift_m)


@pytest.mark.parametrize(
    ("turn_deg", "shift_m", "warns"),
    [
        (0, (0, 0), False),
        (0, (0.2, 0), False),
        (0, (0.4, 0), True),
        (0, (0, -5), True),
        (2, (0, 0), False),
        (8, (0, 0), True),
        (180, (7, 2), True),
    ],
)
def test_only_what_is_large_and_explains_the_error_is_told(turn_deg, shift_m, warns):
    track, truth = walk()
    # Turned about the middle of the walk, so that the turn alone does not shift it.
    middle = truth.mean(axis=0)
    reference = moved(truth - middle, np.radians(turn_deg), middle + shift_m)
    words = frame_offset_words(find_frame_offset(track, reference))
    assert (words is not None) == warns


def test_a_mirrored_reference_is_told_from_a_turned_one_and_from_a_bend():
    track, truth = walk()
    assert "0.07 m mirrored" in mirror_words(track, truth[:, ::-1])
    assert mirror_words(track, moved(truth, 2.0, (5, 5))) is None
    along_m = np.linspace(0, 50, 200)
    bend_m = 0.5 * np.sin(along_m * np.pi / 50)
    assert mirror_words(np.column_stack([along_m, bend_m]), np.column_stack([along_m, -bend_m])) is None


def test_silence_of_the_reference_is_left_out_and_too_little_says_nothing():
    track, truth = walk()
    reference = moved(truth, 0.5, (1, 2))
    holes = reference.copy()
    holes[::3] = np.nan
    np.testing.assert_allclose(
        find_frame_offset(track, holes).shift_m,
        find_frame_offset(track[np.arange(200) % 3 > 0], reference[np.arange(200) % 3 > 0]).shift_m,
    )
    assert find_frame_offset(track[:9], reference[:9]) is None
    assert find_frame_offset(track, np.full((200, 2), np.nan)) is None
