from __future__ import annotations

import pytest

from quadlog.recordings.decoders.uwb import ends_of_topic


@pytest.mark.parametrize(
    ("topic", "ends"),
    [
        ("/uwb/tof/n_3/n_7/distance", (3, 7)),
        ("/uwb/anchor_4/range", (0, 4)),
        ("/uwb/anchor_0/tag_2", (2, 0)),
        ("/uwb/tag_0/anchor_2", (0, 2)),
        ("/uwb/Anchor0/Tag2/range", (2, 0)),
        ("/uwb/anchors/0/n_2", (2, 0)),
        ("/uwb/anchor_id_0_tag_id_2", (2, 0)),
        ("/uwb/anchor_3/n_7", (7, 3)),
        ("/uwb/n_3/tag_7", (7, 3)),
        ("/uwb_anchor/n_3/n_7", (3, 7)),
        ("/uwb/tag_2/range", None),
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


def test_words_decide_before_known_anchors() -> None:
    assert ends_of_topic("/uwb/anchor_0/tag_2", anchor_ids=[0, 1, 2]) == (2, 0)
    assert ends_of_topic("/uwb/anchor_0/tag_2", anchor_ids=[2]) == (2, 0)
    assert ends_of_topic("/uwb/tag_0/anchor_2", anchor_ids=[0]) == (0, 2)
    assert ends_of_topic("/uwb/anchor_0/anchor_2", anchor_ids=[0]) == (2, 0)


def test_the_configuration_decides_first() -> None:
    assert ends_of_topic("/n_7/n_5", {"/n_7/n_5": (1, 2)}, [7]) == (1, 2)
