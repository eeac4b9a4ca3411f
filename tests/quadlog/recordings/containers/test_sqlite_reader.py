from __future__ import annotations

import sqlite3

import pytest

from quadlog.errors import NotARecording, NothingReadable, QuadlogError
from quadlog.recordings.containers.open import open_container
from tests.lab import recordings


def change(path, *statements):
    """Executes SQL in a database."""
    database = sqlite3.connect(path)
    for each in statements:
        database.execute(*each) if isinstance(each, tuple) else database.execute(each)
    database.commit()
    database.close()


@pytest.fixture
def crashed(tmp_path):
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


def test_a_wal_that_was_never_checkpointed_is_read_and_nothing_is_written_beside_it(crashed):
    messages = recordings.some()
    before = {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in crashed.iterdir()}

    with open_container(crashed / "a.db3") as container:
        assert recordings.read(container) == messages
        assert "a.db3-wal" in container.warnings[0]
        assert {path.name for path in crashed.iterdir()} == set(before)
    assert {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in crashed.iterdir()} == before


def test_foreign_serialization_is_refused_by_name(tmp_path):
    path = recordings.db3(tmp_path / "a.db3", recordings.some(), serialization="protobuf")
    with pytest.raises(NothingReadable, match="'protobuf'"):
        open_container(path)
    change(path, "UPDATE topics SET serialization_format = 'cdr' WHERE name = '/a'")
    with open_container(path) as container:
        assert {topic for topic, _, _ in recordings.read(container)} == {"/a"}
        (loss,) = container.losses
        assert (loss.cause, loss.topic, loss.count) == ("serialization", "/b", 30)
        assert {channel.topic for channel in container.channels} == {"/a", "/b"}


def test_definitions_of_newer_distributions_are_the_schema(tmp_path):
    path = recordings.db3(tmp_path / "a.db3", recordings.some())
    columns = "id INTEGER PRIMARY KEY, topic_type, encoding, encoded_message_definition, type_description_hash"
    values = (recordings.TYPE_NAME, "ros2msg", "string data", "")
    insert = "INSERT INTO message_definitions VALUES (1, ?, ?, ?, ?)"
    change(path, f"CREATE TABLE message_definitions({columns})", (insert, values))
    with open_container(path) as container:
        assert {(c.schema_encoding, c.schema) for c in container.channels} == {("ros2msg", b"string data")}


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
        open_container(path)


@pytest.mark.parametrize("index", [True, False])
@pytest.mark.parametrize("place", [0.2, 0.5, 0.8])
def test_a_damaged_page_costs_its_rows_only(tmp_path, index, place):
    """Of pages of 4 kB, each with some 40 rows."""
    messages = recordings.some(2000)
    path = recordings.db3(tmp_path / "a.db3", messages, index=index)
    data = path.read_bytes()
    begin = data.find(b"%06d" % round(2000 * place)) // 4096 * 4096
    path.write_bytes(data[:begin] + bytes(4096) + data[begin + 4096 :])
    with open_container(path) as container:
        got = recordings.read(container)
        assert got == [message for message in messages if message in got]
        assert 1900 < len(got) < 2000
        assert recordings.causes(container) == ["damaged"]


def test_real_bags_give_every_row(edge_cases):
    paths = [*edge_cases.rglob("*.db3"), *edge_cases.parent.glob("uwb_tiers/*/*.db3")]
    assert len(paths) > 8
    for path in paths:
        database = sqlite3.connect(f"file:{path}?immutable=1", uri=True)
        query = "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id ORDER BY timestamp,"
        rows = database.execute(f"{query} messages.id").fetchall()
        database.close()
        try:
            with open_container(path) as container:
                assert recordings.read(container) == rows
                assert container.losses == []
        except QuadlogError as error:
            pytest.fail(str(error))
