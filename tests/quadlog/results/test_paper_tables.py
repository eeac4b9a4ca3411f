from __future__ import annotations

import pytest

from quadlog.errors import AlreadyExists, CannotWrite
from quadlog.results.paper_rows import PaperRow, PaperTable, Picture, RowGroup
from quadlog.results.paper_tables import prepare_folder, write_readme, write_table


def table(name: str) -> PaperTable:
    group = RowGroup("Group", "Text.", (PaperRow("a (m)", 1.0),))
    return PaperTable(name, f"Title of {name}", "Caption.", "Sizes.", 0, False, (group,), (Picture("p", "", "", b"P"),))


def test_a_table_is_its_section_its_files_and_its_pictures(tmp_path):
    prepare_folder(tmp_path / "new" / "folder", ["one"], force=False)
    write_table(tmp_path / "new" / "folder", table("one"))
    files = {path.name: path.read_bytes() for path in (tmp_path / "new" / "folder").iterdir()}
    assert set(files) == {"one.csv", "one.tex", "one.md", "one-p.png"}
    assert files["one-p.png"] == b"P"
    assert write_readme(tmp_path / "new" / "folder", ["one"]).name == "README.md"


def test_the_page_has_all_tables_there_are_in_the_order_asked_for(tmp_path):
    for name in ("two", "one", "three"):
        write_table(tmp_path, table(name))
    (tmp_path / "other.md").write_text("## Somebody's own\n")
    text = write_readme(tmp_path, ["one", "missing", "two"]).read_text()
    assert text.index("## Title of one") < text.index("## Title of two")
    assert "three" not in text
    assert "Somebody" not in text


@pytest.mark.parametrize("name", ["README.md", "one.csv", "one.tex", "one.md", "one-p.png"])
def test_nothing_is_overwritten_without_force(tmp_path, name):
    (tmp_path / name).write_text("mine")
    with pytest.raises(AlreadyExists, match="--force"):
        prepare_folder(tmp_path, ["one"], force=False)
    prepare_folder(tmp_path, ["one"], force=True)
    assert (tmp_path / name).read_text() == "mine"


def test_a_table_that_is_not_asked_for_does_not_stand_in_the_way(tmp_path):
    (tmp_path / "two.csv").write_text("mine")
    (tmp_path / "two-p.png").write_text("mine")
    prepare_folder(tmp_path, ["one"], force=False)


def test_a_file_in_the_folders_place_is_told(tmp_path):
    (tmp_path / "taken").touch()
    with pytest.raises(CannotWrite, match="taken"):
        prepare_folder(tmp_path / "taken", ["one"], force=True)
