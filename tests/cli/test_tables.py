from __future__ import annotations

import csv
from concurrent.futures import ThreadPoolExecutor

import pytest

from quadlog.cli.main import run
from quadlog.pipelines.tables import TABLES, following_uwb
from quadlog.pipelines.tables import make_tables as paper_tables


@pytest.fixture(scope="module", autouse=True)
def _few_draws():
    """The command as it is, only with fewer draws."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(following_uwb, "BATCHES", 3)
        patch.setattr(paper_tables, "LocalPool", lambda _: ThreadPoolExecutor(1))
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tables") / "out"
    assert run(["tables", "following-uwb", "-o", str(folder), "--fast"]) == 0
    return folder


def test_the_csv_file_holds_what_the_contract_says(made):
    with (made / "following-uwb.csv").open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert list(rows[0]) == ["quantity", "paper", "ours", "low", "high", "difference", "reproduces", "note"]
    for row in rows:
        assert row["reproduces"] in {"yes", "no", "undecided", "not comparable", ""}
        low, ours, high, paper, difference = (
            float(row[name] or "nan") for name in ("low", "ours", "high", "paper", "difference")
        )
        assert low <= ours <= high or low != low != high
        assert difference == pytest.approx(ours - paper, abs=2e-5, nan_ok=True)
    assert sum(row["reproduces"] == "no" for row in rows) >= 5


def test_stdout_has_the_verdicts_and_stderr_the_progress(tmp_path, quadlog):
    code, out, err = quadlog("tables", "following-uwb", "-o", tmp_path, "--fast", "--seed", "2")
    lines = out.splitlines()
    assert (code, err) == (0, "following-uwb: fast run, seed 2\n")
    assert lines[0].startswith("following-uwb: ")
    assert " claims: 5 do not, " in lines[0]
    assert lines[-1].startswith(str(tmp_path / "report.html"))
    assert quadlog("tables", "following-uwb", "-o", tmp_path).code == 1


def test_every_table_is_offered(tmp_path, ok, refused):
    error = refused(2, "tables", "following-uvb", "-o", tmp_path / "out")
    assert "following-uvb" in error
    out = ok("tables", "--help")
    assert all(name in error and name in out for name in TABLES)
    assert not (tmp_path / "out").exists()
