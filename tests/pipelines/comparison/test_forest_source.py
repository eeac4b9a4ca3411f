from __future__ import annotations

import pytest

from quadlog.errors import UsageError
from quadlog.pipelines.comparison.sources import forest_source
from quadlog.planning.rules import Rules


def first_questions(name: str, leader: str = "astar", seed: int = 0, episodes: int = 1):
    source = forest_source(name, episodes, leader, Rules(), "euclidean", seed)
    return [next(iter(episode)) for episode in source.episodes()]


@pytest.mark.parametrize("name", ["forest:-1", "forest:abc", "forest:nan", "forest:", "forest:inf", "forest:2.01"])
def test_a_density_that_is_none_is_usage(name):
    with pytest.raises(UsageError, match=rf"{name}: trees per m² between 0 and 2, as in  forest:0\.2"):
        forest_source(name, 1, "astar", Rules(), "euclidean", 0)


def test_episodes_are_drawn_from_the_seed_and_told_apart():
    one, two = first_questions("forest:0.3", episodes=2)
    again, _ = first_questions("forest:0.3", episodes=2)
    (other,) = first_questions("forest:0.3", seed=1)
    assert (one.occupied == again.occupied).all()
    assert one.occupied.shape == (40, 40)
    assert not (one.occupied == two.occupied).all()
    assert not (one.occupied == other.occupied).all()


def test_it_says_who_leads():
    assert "led by ia_star" in forest_source("forest:0.1", 3, "ia_star", Rules(), "square", 5).about
    assert "seed 5" in forest_source("forest:0.1", 3, "ia_star", Rules(), "square", 5).about
