from __future__ import annotations

import pytest

from quadlog.errors import AlreadyExists, CannotWrite
from quadlog.results.papers.page import Appendix, prepare_folder, reusable_tables, write_readme, write_table

FILES = {"one.csv", "one.tex", "one.json", "one-site.png"}


def test_a_table_is_its_files_and_its_pictures(tmp_path, saved):
    folder = tmp_path / "new" / "folder"
    prepare_folder(folder, ["one"], [], force=False)
    write_table(folder, saved("one"))
    assert {path.name for path in folder.iterdir()} == FILES
    assert (folder / "one-site.png").read_bytes() == b"\x89PNG"
    assert write_readme(folder, ["one"], "code", [], force=False).name == "README.md"


def test_the_page_has_all_tables_there_are_in_the_order_asked_for(tmp_path, saved):
    for name in ("two", "one", "three"):
        write_table(tmp_path, saved(name))
    (tmp_path / "other.json").write_text("{}")
    appendices = [Appendix("Errata", "None.\n")]
    text = write_readme(tmp_path, ["one", "missing", "other", "two"], "code", appendices, force=False).read_text()
    assert text.index("## Title of one") < text.index("## Title of two") < text.index("## Errata\n\nNone.")
    assert "three" not in text


@pytest.mark.parametrize("name", ["README.md", "report.html", *sorted(FILES)])
def test_nothing_is_overwritten_without_force(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(AlreadyExists, match="--force"):
        prepare_folder(tmp_path, ["one"], [], force=False)
    prepare_folder(tmp_path, ["one"], [], force=True)
    assert (tmp_path / name).read_text() == "mine"


@pytest.mark.parametrize("name", sorted(FILES))
def test_a_reused_table_may_lie_there_as_it_is_and_not_otherwise(tmp_path, name, saved):
    write_table(tmp_path, saved("one"))
    (tmp_path / "README.md").write_text("the page is looked at when it is written")
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


def test_another_page_is_not_overwritten_without_force(tmp_path, saved):
    write_table(tmp_path, saved("one"))
    page = write_readme(tmp_path, ["one"], "code", [], force=False)
    before = page.read_text()
    write_readme(tmp_path, ["one"], "code", [], force=False)
    page.write_text("mine")
    with pytest.raises(AlreadyExists, match="README"):
        write_readme(tmp_path, ["one"], "code", [], force=False)
    assert page.read_text() == "mine"
    write_readme(tmp_path, ["one"], "code", [], force=True)
    assert page.read_text() == before


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
