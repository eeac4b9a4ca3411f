from __future__ import annotations

import numpy as np
import pytest

from quadlog.config.file import commented_toml, load_config
from quadlog.config.schema import Config
from quadlog.errors import NotARun, TooLarge, TooSteep, UnknownName, UnreadableFile
from quadlog.pipelines.simulation.courses import LEAST_POINTS, MARGIN_M, find_course, ground_remarks, make_ground
from quadlog.results.run.maps import GroundMap, write_ground
from quadlog.simulation.course_walk import Course

BEND = Course("bend", np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0]]), 0.6)


def _config(*settings):
    return load_config(None, settings, {})


def _run(folder, height_m, origin_m=(-6.0, -6.0), cell_m=0.2):
    folder.mkdir(exist_ok=True)
    write_ground(folder, GroundMap(np.array(origin_m), cell_m, height_m, np.full(height_m.shape, LEAST_POINTS)))
    return f"simulation.terrain={folder}"


@pytest.mark.parametrize(("course", "own_mps"), [("line", 0.6), ("circle", 0.6), ("s-curve", 0.5), ("file", 0.6)])
def test_a_course_has_its_own_speed_unless_it_is_told_another(tmp_path, course, own_mps):
    path = tmp_path / "path.csv"
    path.write_text("0,0\n1,0\n")
    name = str(path) if course == "file" else course
    assert find_course(name, _config()).speed_mps == own_mps
    told = find_course(name, _config("pursuit.speed_mps=0.7"))
    assert told.speed_mps == 0.7
    np.testing.assert_array_equal(told.path_m, find_course(name, _config()).path_m)


def test_the_config_that_init_writes_leaves_courses_their_speed(tmp_path):
    written = tmp_path / "quadlog.toml"
    written.write_text(commented_toml(Config()))
    assert "# speed_mps =" in written.read_text()
    assert find_course("s-curve", load_config(written, [], {})).speed_mps == 0.5


def test_a_path_that_ends_where_it_begins_to_be_walked_is_refused(tmp_path):
    path = tmp_path / "short.csv"
    path.write_text("0,0\n0.06,0\n0.06,0.04\n")
    with pytest.raises(UnreadableFile, match=r"short\.csv: is walked before it begins: 0\.1 m"):
        find_course(str(path), _config())
    path.write_text("0,0\n0.06,0\n0,0\n")
    assert len(find_course(str(path), _config()).path_m) == 3


def test_a_run_folder_is_the_ground_it_saw(tmp_path):
    rng = np.random.default_rng(0)
    height_m = rng.uniform(0, 0.02, (60, 60))
    config = _config(_run(tmp_path / "run", height_m))
    ground = make_ground("bend", BEND, config, 0)
    rows, cols = np.meshgrid(np.arange(16, 47), np.arange(16, 47), indexing="ij")
    centres_m = -6 + 0.2 * (np.stack([cols.ravel(), rows.ravel()], axis=1) + 0.5)
    inside = (centres_m > -MARGIN_M).all(axis=1) & (centres_m < [2 + MARGIN_M, 1 + MARGIN_M]).all(axis=1)
    np.testing.assert_allclose(
        ground.height_at(centres_m[inside]), height_m[rows.ravel(), cols.ravel()][inside], atol=1e-6
    )
    again = make_ground("bend", BEND, config, 5)
    assert again.height_m.tobytes() == ground.height_m.tobytes()
    assert ground_remarks(BEND, config).warnings == ()
    assert "SHA-256" in ground_remarks(BEND, config).notes[0]


def test_ground_is_there_wherever_the_course_goes_and_it_is_said_where_it_was_not_seen(tmp_path):
    config = _config(_run(tmp_path / "run", np.full((10, 10), 0.3), origin_m=(-1.0, -1.0)))
    far = Course("far", np.array([[0.0, 0.0], [15.0, 0.0]]), 0.6)
    ground = make_ground("far", far, config, 0)
    assert ground.origin_m[0] <= -MARGIN_M
    assert ground.origin_m[0] + ground.cell_m * (ground.height_m.shape[1] - 1) >= 15 + MARGIN_M
    assert not ground.is_plane
    assert set(ground.height_m.ravel().tolist()) == {float(np.float32(0.3))}
    (warning,) = ground_remarks(far, config).warnings
    assert warning.startswith("13.6 of the course's 15.0 m, the first at (1.5, 0.0) m, lie beyond the ground that")


def test_steep_ground_is_refused_where_the_course_goes_and_let_be_elsewhere(tmp_path):
    height_m = np.zeros((60, 60))
    height_m[-3:, -3:] = 4.0
    config = _config(_run(tmp_path / "run", height_m))
    assert make_ground("bend", BEND, config, 0).too_steep_for(0.8) is None
    height_m[30:, 36:] = 4.0
    with pytest.raises(TooSteep, match="choose another terrain"):
        make_ground("bend", BEND, _config(_run(tmp_path / "run", height_m)), 0)


def test_what_is_no_terrain_is_refused_with_the_choices(tmp_path):
    for ask in (lambda config: make_ground("bend", BEND, config, 0), lambda config: ground_remarks(BEND, config)):
        with pytest.raises(UnknownName, match="3cm, 6cm, a run folder, course, flat"):
            ask(_config("simulation.terrain=9cm"))
        with pytest.raises(NotARun, match=r"no terrain without a ground\.npz"):
            ask(_config(f"simulation.terrain={tmp_path}"))
        with pytest.raises(NotARun, match=f"none of its cells holds {LEAST_POINTS} points"):
            ask(_config(_run(tmp_path / "empty", np.full((4, 4), np.nan))))


def test_a_ground_too_fine_for_its_course_is_refused_before_it_is_made(tmp_path):
    config = _config(_run(tmp_path / "run", np.zeros((9, 9)), cell_m=0.001))
    with pytest.raises(TooLarge, match="the ground's corners"):
        make_ground("bend", BEND, config, 0)


@pytest.mark.parametrize("terrain", ["flat", "3cm", "6cm", "course"])
def test_drawn_grounds_need_no_remark(terrain):
    remarks = ground_remarks(BEND, _config(f"simulation.terrain={terrain}"))
    assert remarks.notes == remarks.warnings == ()
