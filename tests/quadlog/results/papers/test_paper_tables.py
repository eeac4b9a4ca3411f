from __future__ import annotations

import pytest

from quadlog.errors import AlreadyExists, CannotWrite
from quadlog.results.papers.folder import prepare_folder, reusable_tables, saved_tables, write_report, write_table

FILES = {"one.csv", "one.tex", "one.json", "one-site.png"}


def test_a_table_is_its_files_and_its_pictures(tmp_path, saved):
    folder = tmp_path / "new" / "folder"
    prepare_folder(folder, ["one"], [], force=False)
    write_table(folder, saved("one"))
    assert {path.name for path in folder.iterdir()} == FILES
    assert (folder / "one-site.png").read_bytes() == b"\x89PNG"


def test_the_tables_of_a_folder_come_in_the_order_asked_for(tmp_path, saved):
    for name in ("two", "one", "three"):
        write_table(tmp_path, saved(name))
    (tmp_path / "other.json").write_text("{}")
    assert [each.table.name for each in saved_tables(tmp_path, ["one", "missing", "other", "two"])] == ["one", "two"]


@pytest.mark.parametrize("name", ["report.html", *sorted(FILES)])
def test_nothing_is_overwritten_without_force(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(AlreadyExists, match="--force"):
        prepare_folder(tmp_path, ["one"], [], force=False)
    prepare_folder(tmp_path, ["one"], [], force=True)
    assert (tmp_path / name).read_text() == "mine"


@pytest.mark.parametrize("name", sorted(FILES))
def test_a_reused_table_may_lie_there_as_it_is_and_not_otherwise(tmp_path, name, saved):
    write_table(tmp_path, saved("one"))
    (tmp_path / "report.html").write_text("the page is looked at when it is written")
    prepare_folder(tmp_path, [], [saved("one")], force=False)
    (tmp_path / name).write_text("mine")
    with pytest.raises(AlreadyExists, match=name):
        prepare_folder(tmp_path, [], [saved("one")], force=False)
    prepare_folder(tmp_path, [], [saved("one")], force=True)
    (tmp_path / name).unlink()
    prepare_folder(tmp_path, [], [saved("one")], force=False)


def test_files_as_they_should_be_are_not_written_again(tmp_path, saved):
    write_table(tmp_path, saved("one"))
    before = {path.name: path.stat().st_ino for path in tmp_path.iterdir()}
    write_table(tmp_path, saved("one"))
    assert {path.name: path.stat().st_ino for path in tmp_path.iterdir()} == before
    (tmp_path / "one.csv").write_text("mine")
    write_table(tmp_path, saved("one"))
    assert (tmp_path / "one.csv").read_text().startswith("quantity,")


def test_another_page_is_not_overwritten_without_force(tmp_path):
    page = tmp_path / "report.html"
    for _ in range(2):
        write_report(tmp_path, b"page", force=False)
    page.write_text("mine")
    with pytest.raises(AlreadyExists, match="report"):
        write_report(tmp_path, b"page", force=False)
    assert page.read_text() == "mine"
    write_report(tmp_path, b"page", force=True)
    assert page.read_bytes() == b"page"


@pytest.mark.parametrize("other", [{"code": "other"}, {"fast": True}, {"seed": 1}])
def test_only_what_has_the_same_origin_is_reused(tmp_path, other, saved):
    write_table(tmp_path, saved("one"))
    write_table(tmp_path, saved("two", **other))
    origin = saved().origin
    assert reusable_tables(tmp_path, ["two", "one", "three"], origin) == [saved("one")]
    assert reusable_tables(tmp_path / "elsewhere", ["one"], origin) == []


def test_a_table_that_is_not_asked_for_does_not_stand_in_the_way(tmp_path):
    (tmp_path / "two.csv").write_text("mine")
    (tmp_path / "two-site.png").write_text("mine")
    prepare_folder(tmp_path, ["one"], [], force=False)
    assert [each.read_text() for each in sorted(tmp_path.iterdir())] == ["mine", "mine"]


def test_a_file_in_the_folders_place_is_told(tmp_path):
    (tmp_path / "taken").touch()
    with pytest.raises(CannotWrite, match="taken"):
        prepare_folder(tmp_path / "taken", ["one"], [], force=True)
