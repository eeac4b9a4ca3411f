import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from quadlog.errors import NotARun
from quadlog.results.folder_report import write_folder_report
from quadlog.results.schemas import TABLES
from quadlog.results.tables import write_table

HOSTILE = "</script><script>alert(1)</script>"


def _summary(folder: Path, **columns: Any) -> None:
    write_table(folder / "summary.parquet", TABLES["summary"], columns)


def _rows(page: str) -> list[str]:
    body = re.search(r"<tbody>(.*)</tbody>", page, re.DOTALL)
    assert body is not None
    return body[1].split("</tr>")[:-1]


def test_a_row_for_each_recording_with_its_outcome_and_metrics(tmp_path: Path) -> None:
    (tmp_path / "walk #1").mkdir()
    (tmp_path / "walk #1" / "report.html").write_text("")
    _summary(
        tmp_path,
        recording=["walk #1", "torn", "empty"],
        exit_code=[0, 3, 1],
        reason=["", "12 messages lost", "nothing readable"],
        eta_m=[0.0345678, 0.5, np.nan],
        expanded_total=[1234567.0, np.nan, np.nan],
    )
    page = write_folder_report(tmp_path).read_text()
    first, second, third = _rows(page)
    assert '<a href="./walk%20%231/report.html">walk #1</a>' in first
    assert ">0 done<" in first
    assert 'data-value="0.0345678">0.03457<' in first
    assert "1\u2009234\u2009567" in first
    assert ">3 with loss<" in second
    assert "12 messages lost" in second
    assert "<a " not in second
    assert ">1 failed<" in third
    assert third.count('data-value="">–<') == 2
    assert "sigma_m" not in page  # a metric that no run has


def test_hostile_names_stay_text_and_lead_nowhere(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    (tmp_path / "report.html").write_text("")
    names = ["..", HOSTILE, "javascript:alert(1)", "a/../..", "."]
    _summary(tmp_path / "runs", recording=names, exit_code=[1] * 5, reason=[HOSTILE] * 5)
    page = write_folder_report(tmp_path / "runs").read_text()
    assert page.count("<script>") == 1
    assert "<a " not in page
    assert len(_rows(page)) == 5


def test_an_empty_summary_is_a_page_and_a_missing_one_is_refused(tmp_path: Path) -> None:
    with pytest.raises(NotARun, match=r"summary\.parquet"):
        write_folder_report(tmp_path)
    _summary(tmp_path, recording=np.array([], object), exit_code=np.array([], int), reason=np.array([], object))
    assert "no recordings" in write_folder_report(tmp_path).read_text()


def test_the_same_summary_gives_the_same_bytes(tmp_path: Path) -> None:
    _summary(tmp_path, recording=["a", "b"], exit_code=[0, 0], reason=["", ""], eta_m=[1.0, 2.0])
    assert write_folder_report(tmp_path).read_bytes() == write_folder_report(tmp_path).read_bytes()
