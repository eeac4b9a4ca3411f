"""A saved run from Python: `quadlog.load_run`."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import quadlog
from quadlog.cli.main import run as run_cli
from quadlog.errors import NotARun, TooLarge, UnknownName
from quadlog.results.page.verdict import status
from quadlog.results.record import RunRecord, SavedMetric
from quadlog.results.run import Run
from quadlog.results.tables import TABLES
from tests.lab.runs import change


def test_tables_are_those_of_the_files_with_seconds_read_once(tiny_run: Path) -> None:
    run = quadlog.load_run(str(tiny_run))
    for path in tiny_run.glob("*.parquet"):
        table = run.table(path.stem)
        assert table is not None
        expected = pq.read_table(path).to_pandas()
        assert list(table.drop(columns="seconds", errors="ignore")) == list(expected)
        for name in expected:
            np.testing.assert_array_equal(table[name], expected[name])
        if "t_ns" in table:
            assert table["t_ns"].dtype == np.int64
            np.testing.assert_allclose(table["seconds"], (table["t_ns"] - run.start_ns) / 1e9)
    poses = run.table("poses")
    (tiny_run / "poses.parquet").unlink()
    assert run.table("poses") is poses is not None


def test_everything_else_is_that_of_the_files(tiny_run: Path, tiny_record: RunRecord) -> None:
    run = quadlog.load_run(tiny_run)
    assert (run.path, run.record.model_dump(mode="json")) == (tiny_run, tiny_record.model_dump(mode="json"))
    assert run.config.planner.name == "ia_star"
    assert run.metrics == {"eta_m": SavedMetric(0.123, 200, "m"), "fallen": SavedMetric(0, 1)}
    assert (run.metric("eta_m"), run.metric("ate_rmse_m")) == (0.123, None)
    assert (run.title, run.simulated) == ("walk.mcap", False)
    assert run.maps is not None
    assert (len(run.maps), run.maps.shape, run.maps.occupied(0).dtype) == (40, (60, 50), np.bool_)
    assert set(run.arrays("ground") or ()) >= {"height_m", "origin_m"}
    assert len((run.trajectory("trajectory") or run.trajectory("none")).t_ns) == 40  # type: ignore[union-attr]


def test_what_is_missing_is_none_and_an_unknown_name_is_refused(tiny_run: Path) -> None:
    for name in ("control.parquet", "maps.npz", "ground.npz", "trajectory.tum", "metrics.json"):
        (tiny_run / name).unlink()
    run = quadlog.load_run(tiny_run)
    missing = (run.table("control"), run.maps, run.arrays("ground"), run.trajectory("trajectory"), run.metric("eta_m"))
    assert missing == (None,) * 5
    assert run.metrics == {}
    for wrong in ("../walk/poses", "pose"):
        with pytest.raises(UnknownName):
            run.table(wrong)


def test_a_folder_that_is_no_run_is_refused_and_damage_when_it_is_read(
    tiny_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(NotARun, match="no such folder"):
        quadlog.load_run(tmp_path / "nowhere")
    with pytest.raises(NotARun, match=r"has no run\.json"):
        quadlog.load_run(tmp_path)
    for name in ("poses.parquet", "maps.npz", "ground.npz", "metrics.json"):
        (tiny_run / name).write_bytes(b"PAR1 damaged")
    run = quadlog.load_run(tiny_run)
    reads = (lambda: run.table("poses"), lambda: run.maps, lambda: run.arrays("ground"), lambda: run.metrics)
    for read in reads:
        with pytest.raises(NotARun, match=r"^[^\n]{1,400}$"):
            read()
    assert run.table("plans") is not None
    assert run_cli(["report", str(tiny_run)]) == 1
    assert len(capsys.readouterr().err.splitlines()) == 1


READS: dict[str, Callable[[Run], Any]] = {
    "poses.parquet": lambda run: pd.DataFrame(run.table("poses")).to_csv(),
    "maps.npz": lambda run: [(t_ns, *origin_m, cells.tobytes()) for t_ns, origin_m, cells in run.maps or ()],
    "ground.npz": lambda run: {name: array.tobytes() for name, array in run.arrays("ground").items()},
}


@given(st.sampled_from(sorted(READS)), st.integers(0, 100_000), st.integers(1, 255), st.integers(0, 100_000))
def test_a_damaged_file_is_refused_or_right(
    tiny_original: Path, tmp_path_factory: pytest.TempPathFactory, name: str, place: int, flip: int, end: int
) -> None:
    folder, record = tmp_path_factory.mktemp("run"), Run(tiny_original).record
    shutil.copy(tiny_original / name, folder)
    whole, content = READS[name](Run(folder, record)), bytearray((folder / name).read_bytes())
    content[place % len(content)] ^= flip
    for damaged in (content, content[: end % len(content)]):
        (folder / name).write_bytes(damaged)
        try:
            found = READS[name](Run(folder, record))
        except (NotARun, TooLarge) as error:
            assert re.search(rf"{name}[^\n]+$", str(error))  # noqa: PT017 - either outcome is right
        else:
            assert found == whole


def test_values_beyond_all_measure_are_missing_with_a_note(tiny_run: Path) -> None:
    change(tiny_run, "poses", x_m=lambda x_m: np.where(np.arange(len(x_m)) < 3, -2e12, x_m))
    change(tiny_run, "clearances", clearance_m=np.inf)  # valid there
    run = quadlog.load_run(tiny_run)
    tables: Any = [run.table(name) for name in ("poses", "clearances")]
    assert tables[0]["x_m"].isna().sum() == 3
    assert np.isinf(tables[1]["clearance_m"]).all()
    assert run.notes == ["3 values of poses.x_m beyond 1e+12 are not shown"]


def test_a_notebook_shows_what_a_run_is_and_has_and_draws_its_figures(tiny_run: Path) -> None:
    run = Run(tiny_run)
    assert run.tables == [name for name in TABLES if (tiny_run / f"{name}.parquet").exists()]
    assert all(word in repr(run) for word in ("Run walk: ", status(run)[0], " s, tables: ", "poses"))
    page = run._repr_html_()
    assert all(word in page for word in ("Simulated walk", "contacts", "control"))
    (tiny_run / "control.parquet").write_bytes(b"damaged")
    assert "control" in repr(Run(tiny_run))
    picture = Run(tiny_run).figure("uwb_error", width="89mm", height="2in", font="serif")
    assert tuple(picture.get_size_inches()) == pytest.approx((89 / 25.4, 2.0))
    with pytest.raises(UnknownName, match="did you mean uwb_error"):
        run.figure("uwb_eror")
    assert not {"create", "finish", "write"} & set(dir(run))  # what makes runs is not for readers
