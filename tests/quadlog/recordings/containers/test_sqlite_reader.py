from __future__ import annotations

import sqlite3

import pytest

from quadlog.errors import NotARecording, NothingReadable, QuadlogError, TooLarge
from quadlog.recordings.containers.db3 import open_sqlite


def change(path, *statements):
    """Executes SQL in a database."""
    database = sqlite3.connect(path)
    for each in statements:
        database.execute(*each) if isinstance(each, tuple) else database.execute(each)
    database.commit()
    database.close()


@pytest.fixture
def crashed(tmp_path, recordings):
    """As a killed recorder leaves it: a database with half of the messages, the others in its -wal, no -shm."""
    messages = recordings.some()
    source = tmp_path / "recorder.db3"
    writer = sqlite3.connect(source)
    writer.execute("PRAGMA journal_mode=WAL")
    writer.execute("PRAGMA wal_autocheckpoint=0")
    recordings.fill_db3(writer, messages[:30])
    writer.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    writer.executemany(
        "INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
        [(1 if topic == "/b" else 2, t_ns, payload) for topic, t_ns, payload in messages[30:]],
    )
    writer.commit()
    crashed = tmp_path / "crashed"
    crashed.mkdir()
    for suffix in ("", "-wal"):
        (crashed / f"a.db3{suffix}").write_bytes((tmp_path / f"recorder.db3{suffix}").read_bytes())
    writer.close()
    return crashed


def test_a_wal_that_was_never_checkpointed_is_read_and_nothing_is_written_beside_it(crashed, recordings):
    messages = recordings.some()
    before = {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in crashed.iterdir()}

    with open_sqlite(crashed / "a.db3") as container:
        assert recordings.read(container) == messages
        assert "a.db3-wal" in container.warnings[0]
        assert {path.name for path in crashed.iterdir()} == set(before)
    assert {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in crashed.iterdir()} == before


@pytest.mark.parametrize("linked", ["file", "file and wal", "folder"])
def test_a_link_does_not_hide_the_wal(crashed, tmp_path, recordings, linked):
    """It lies beside the file that the link leads to or, as file stores do it, beside the link and itself a link."""
    links = tmp_path / "links"
    if linked == "folder":
        links.symlink_to(crashed)
    else:
        links.mkdir()
        (links / "a.db3").symlink_to(crashed / "a.db3")
    if linked == "file and wal":
        (crashed / "a.db3-wal").rename(crashed / "7f3c")
        (links / "a.db3-wal").symlink_to(crashed / "7f3c")
    with open_sqlite(links / "a.db3") as container:
        assert container.path == links / "a.db3"
        assert recordings.read(container) == recordings.some()
        assert "a.db3-wal" in container.warnings[0]


def test_a_database_in_wal_mode_without_wal_is_read_in_place(tmp_path, recordings):
    messages = recordings.some()
    path = tmp_path / "a.db3"
    writer = sqlite3.connect(path)
    writer.execute("PRAGMA journal_mode=WAL")
    recordings.fill_db3(writer, messages)
    writer.close()
    assert path.read_bytes()[18:20] == b"\2\2"
    with open_sqlite(path) as container:
        assert recordings.read(container) == messages
        assert [each.name for each in tmp_path.iterdir()] == ["a.db3"]
        assert container.warnings == []
    assert [each.name for each in tmp_path.iterdir()] == ["a.db3"]


def test_no_disk_space_for_the_copy_is_too_large(tmp_path, recordings, monkeypatch):
    path = recordings.db3(tmp_path / "a.db3", recordings.some())
    (tmp_path / "a.db3-wal").write_bytes(b"x" * 100)
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 10}))
    with pytest.raises(TooLarge, match="copying it with its -wal"):
        open_sqlite(path)


def test_foreign_serialization_is_refused_by_name(tmp_path, recordings):
    path = recordings.db3(tmp_path / "a.db3", recordings.some(), serialization="protobuf")
    with pytest.raises(NothingReadable, match="'protobuf'"):
        open_sqlite(path)
    change(path, "UPDATE topics SET serialization_format = 'cdr' WHERE name = '/a'")
    with open_sqlite(path) as container:
        assert {topic for topic, _, _ in recordings.read(container)} == {"/a"}
        (loss,) = container.losses
        assert (loss.cause, loss.topic, loss.count) == ("serialization", "/b", 30)
        assert {channel.topic for channel in container.channels} == {"/a", "/b"}


def test_definitions_of_newer_distributions_are_the_schema(tmp_path, recordings):
    path = recordings.db3(tmp_path / "a.db3", recordings.some())
    columns = "id INTEGER PRIMARY KEY, topic_type, encoding, encoded_message_definition, type_description_hash"
    values = (recordings.type_name, "ros2msg", "string data", "")
    insert = "INSERT INTO message_definitions VALUES (1, ?, ?, ?, ?)"
    change(path, f"CREATE TABLE message_definitions({columns})", (insert, values))
    with open_sqlite(path) as container:
        assert {(c.schema_encoding, c.schema) for c in container.channels} == {("ros2msg", b"string data")}


def test_a_row_that_cannot_be_used_costs_itself(tmp_path, recordings):
    messages = recordings.some()
    path = recordings.db3(tmp_path / "a.db3", messages)
    changes = (("data = 'text'", 11), ("timestamp = 'noon'", 21), ("topic_id = 9", 31))
    change(path, *(f"UPDATE messages SET {new} WHERE id = {number}" for new, number in changes))
    with open_sqlite(path) as container:
        got = recordings.read(container)
        assert got == [m for i, m in enumerate(messages, 1) if i not in (11, 21, 31)]
        told = {(loss.cause, loss.topic, loss.count) for loss in container.losses}
        assert told == {("damaged", None, 1), ("damaged", "/b", 1), ("count", "/b", 1)}


def test_the_rest_of_a_truncated_database_is_read(tmp_path, recordings):
    messages = [(topic, t_ns, payload * 10) for topic, t_ns, payload in recordings.some(400)]
    path = recordings.db3(tmp_path / "a.db3", messages)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 3 // 4])
    with open_sqlite(path) as container:
        got = recordings.read(container)
        assert len(got) > 200
        assert set(got) < set(messages)
        assert len(set(got)) == len(got)
        assert "truncated" in recordings.causes(container)
        assert f"{len(data) - len(data) * 3 // 4} bytes" in container.losses[0].detail


def test_a_message_that_is_less_than_a_second_late_is_not_named(tmp_path, recordings):
    ordered = recordings.some(40)
    path = recordings.db3(tmp_path / "b.db3", [*ordered[1:9], ordered[0], *ordered[9:]])
    with open_sqlite(path) as container:
        assert recordings.read(container) == ordered
        assert container.warnings == []


TOPICS = "CREATE TABLE topics(id, name, type, serialization_format)"
NUMBERS = "WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n)"
ENDLESS = f"{NUMBERS} SELECT id, 1 topic_id, 1 timestamp, x'00' data FROM n"


@pytest.mark.parametrize(
    "script",
    [
        "CREATE TABLE other(id)",
        f"{TOPICS}; CREATE VIEW messages AS {ENDLESS}",
        f"{TOPICS}; CREATE TABLE messages(id, topic_id, timestamp, data AS (zeroblob(100000000)))",
        f"{TOPICS}; CREATE TABLE messages(id, topic_id)",
    ],
)
def test_a_database_that_is_no_bag_is_refused(tmp_path, script):
    path = tmp_path / "a.db3"
    change(path, *script.split("; "))
    with pytest.raises(NotARecording, match="ROS 2 bag"):
        open_sqlite(path)


def test_real_bags_give_every_row(edge_cases, recordings):
    paths = [*edge_cases.rglob("*.db3"), *edge_cases.parent.glob("uwb_tiers/*/*.db3")]
    assert len(paths) > 8
    for path in paths:
        database = sqlite3.connect(f"file:{path}?immutable=1", uri=True)
        query = "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id ORDER BY timestamp,"
        rows = database.execute(f"{query} messages.id").fetchall()
        database.close()
        try:
            with open_sqlite(path) as container:
                assert recordings.read(container) == rows
                assert container.losses == []
        except QuadlogError as error:
            pytest.fail(str(error))
