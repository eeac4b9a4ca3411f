from __future__ import annotations

import pytest

from quadlog.recordings.range_topics import ends_of_topic


@pytest.mark.parametrize(
    ("topic", "ends"),
    [
        ("/uwb/tof/n_3/n_7/distance", (3, 7)),
        ("/uwb/anchor_4/range", (0, 4)),
        ("/sonar_2", None),
        ("/range", None),
        ("/a1/b2/c3", None),
        ("/uwb/n_99999999999999999999", None),
    ],
)
def test_names(topic: str, ends: tuple[int, int] | None) -> None:
    assert ends_of_topic(topic) == ends


def test_known_anchors_decide_the_order() -> None:
    assert ends_of_topic("/n_7/n_5", anchor_ids=[7]) == (5, 7)
    assert ends_of_topic("/n_7/n_5", anchor_ids=[5, 7]) == (7, 5)


def test_the_configuration_decides_first() -> None:
    assert ends_of_topic("/n_7/n_5", {"/n_7/n_5": (1, 2)}, [7]) == (1, 2)
