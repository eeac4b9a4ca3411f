"""The folder of the papers' tables: what is written, reused, and never overwritten without force."""

from __future__ import annotations

import io

import pytest
from PIL import Image

from quadlog.errors import AlreadyExists, CannotWrite
from quadlog.results.papers.folder import prepare_folder, reusable_tables, write_report, write_table
from quadlog.results.papers.picture import table_picture
from quadlog.results.papers.table import PaperRow, PaperTable, RowGroup, Verdict

FILES = {"one.csv", "one.tex", "one.json", "one.png"}


def test_a_table_is_its_files(tmp_path, saved):
    folder = tmp_path / "new" / "folder"
    prepare_folder(folder, ["one"], force=False)
    write_table(folder, saved("one"))
    assert {path.name for path in folder.iterdir()} == FILES
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    write_table(folder, saved("one"))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_the_picture_has_what_can_be_compared():
    def table(*rows: PaperRow) -> PaperTable:
        return PaperTable("one", "Title", "", "", 0, False, (RowGroup("Group", "", rows),))

    judged = [
        PaperRow("a (m)", 1.0, 2.0, 0.5, 1.5, Verdict.YES),
        PaperRow("b (m)", 900.0, None, 800.0, 950.0, Verdict.NO, claim="> 5"),
        PaperRow("c (1)", -1.0, 0.0, -2.0, 1.0, Verdict.UNDECIDED),
    ]
    picture, more = table_picture(table(*judged[:2])), table_picture(table(*judged))
    assert picture is not None
    assert more is not None
    with Image.open(io.BytesIO(picture)) as two, Image.open(io.BytesIO(more)) as three:
        assert two.width == three.width == 1200
        assert two.height < three.height
    exact = PaperRow("d (m)", 1.0, 2.0, reproduces=Verdict.NO)
    others = PaperRow("a (m)", 1.0), PaperRow("b", 1.0, 2.0, 0.5, 1.5, Verdict.NOT_COMPARABLE)
    assert table_picture(table(exact, *others)) is None


@pytest.mark.parametrize("name", ["report.html", *sorted(FILES)])
def test_nothing_is_overwritten_without_force(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(AlreadyExists, match="--force"):
        prepare_folder(tmp_path, ["one"], force=False)
    prepare_folder(tmp_path, ["one"], force=True)
    assert (tmp_path / name).read_text() == "mine"
    prepare_folder(tmp_path, ["two"] if name != "report.html" else [], force=False)


def test_another_page_is_not_overwritten_without_force(tmp_path):
    page = tmp_path / "report.html"
    for _ in range(2):
        write_report(tmp_path, b"page", force=False)
    page.write_text("mine")
    with pytest.raises(AlreadyExists, match="report"):
        write_report(tmp_path, b"page", force=False)
    write_report(tmp_path, b"page", force=True)
    assert page.read_bytes() == b"page"


@pytest.mark.parametrize("other", [{"code": "other"}, {"fast": True}, {"seed": 1}])
def test_only_what_has_the_same_origin_and_all_files_is_reused(tmp_path, other, saved):
    write_table(tmp_path, saved("one"))
    write_table(tmp_path, saved("two", **other))
    origin = saved().origin
    assert reusable_tables(tmp_path, ["two", "one", "three"], origin) == [saved("one")]
    (tmp_path / "one.csv").unlink()
    assert reusable_tables(tmp_path, ["one"], origin) == []


def test_a_file_in_the_folders_place_is_told(tmp_path):
    (tmp_path / "taken").touch()
    with pytest.raises(CannotWrite, match="taken"):
        prepare_folder(tmp_path / "taken", ["one"], force=True)
