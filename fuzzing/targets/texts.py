"""Files that people write or other tools do: TOML, maps, trajectories, scenarios, lists, and URLs."""

from __future__ import annotations

import io
import re
from pathlib import Path
from zlib import crc32

from PIL import Image

from fuzzing.oracles import command, expect
from quadlog.config.file import commented_toml, load_config, read_bounds
from quadlog.config.schema import Config
from quadlog.errors import ExitCode
from quadlog.recordings.find import find_recordings
from quadlog.storage.formats.movingai import read_movingai_map, read_movingai_scen
from quadlog.storage.formats.path_file import read_path
from quadlog.storage.formats.ros_map import read_rosmap
from quadlog.storage.formats.tum import read_tum
from quadlog.storage.remote_path import to_path
from quadlog.storage.urls import is_url, redacted, redacted_text


def toml(folder: Path, data: bytes) -> None:
    """A configuration with its anchors, bounds on metrics, or the value of a --set: the first byte chooses."""
    kind, text = (data or b"\0")[0] % 3, data[1:]
    path = folder / "case.toml"
    path.write_bytes(text)
    if kind == 0:
        config = load_config(path)
        path.write_text(commented_toml(config))
        expect(load_config(path) == config, "a configuration does not come back as it was written")
    elif kind == 1:
        read_bounds(path)
    else:
        load_config(None, [text.decode("utf-8", "replace")])


def toml_seeds() -> list[bytes]:
    """Every key with its default, anchors, bounds, and a few settings."""
    anchors = "".join(f"[[uwb.anchors]]\nid = {i}\nx_m = {i}.0\ny_m = 1.5\nz_m = 1.0\n" for i in range(3))
    tags = '[[uwb.tags]]\nid = 0\nrole = "robot"\n[[uwb.range_topics]]\ntopic = "/a"\ntag = 0\nanchor = 1\n'
    bounds = "[default]\nsuccess_rate = { min = 0.99 }\n[recordings.follow]\neta_m = { max = 0.05 }\nuwb_rmse_m = {}\n"
    settings = [
        "uwb.method=huber",
        "topics.lidar=/a",
        "planner.name=a",
        "uwb.anchors=[{id=1,x_m=1,y_m=2}]",
        "grid.cell_m=0.1",
    ]
    configs = ["[uwb]\n" + anchors + tags, "[lidar.mount]\nx_m = 0.1\n[grid]\ncell_m = 0.2\n", commented_toml(Config())]
    texts = [*(b"\0" + each.encode() for each in configs), b"\1" + bounds.encode()]
    return texts + [b"\2" + each.encode() for each in settings]


TOML_TOKENS = (b"9" * 5000, *b"nan inf -inf 1e400 0x7fffffffffffffff 1979-05-27 [[ {a= '''".split())


def maps(folder: Path, data: bytes) -> None:
    """A map_server's yaml beside a sound picture, or a picture beside a sound yaml: the first byte chooses."""
    (folder / "map.pgm").write_bytes(PICTURE)
    (folder / "map.yaml").write_bytes(MAP_YAML)
    (folder / ("map.pgm" if data[:1] == b"\1" else "map.yaml")).write_bytes(data[1:])
    found = read_rosmap(folder / "map.yaml")
    if found.cells.size < 10_000 and crc32(data) % 8 == 0:
        ends = ["--start-cell", "0,0", "--goal-cell", "1,1", "--planner", "dijkstra"]
        command("compare-planners", folder / "map.yaml", *ends, allowed=_ANY)


PICTURE = b"P5\n# a\n6 5\n255\n" + bytes(range(200, 230))
MAP_YAML = (
    b"image: map.pgm\nmode: trinary\nresolution: 0.1\norigin: [-1.0, -2.0, 0.0]\nnegate: 0\n"
    b"occupied_thresh: 0.65\nfree_thresh: 0.25\n"
)
MAP_TOKENS = (*b".inf|.nan|1e300|1e-300|&a |*a|<<: *a|scale|raw|!!int |IHDR|tRNS".split(b"|"),)
_ANY = (ExitCode.DONE, ExitCode.FAILED, ExitCode.USAGE, ExitCode.WITH_LOSS)


def map_seeds() -> list[bytes]:
    """The pair, and pictures of the other kinds."""
    pictures = [PICTURE, b"P2\n2 2\n255\n0 255 100 3\n"]
    for kind, mode in (("PNG", "L"), ("PNG", "RGBA"), ("PNG", "P"), ("BMP", "RGB")):
        out = io.BytesIO()
        Image.new(mode, (6, 5), 3).save(out, kind)
        pictures.append(out.getvalue())
    return [b"\0" + MAP_YAML, *(b"\1" + each for each in pictures)]


def lines(folder: Path, data: bytes) -> None:
    """A trajectory, a path, a MovingAI map or scenario, or a list of recordings: the first byte chooses."""
    kind, text = (data or b"\0")[0] % 5, data[1:]
    path = folder / ("case.tum", "case.csv", "case.map", "case.scen", "case.txt")[kind]
    path.write_bytes(text)
    if kind == 4:
        if b"/" in text or b".." in text:  # would search this machine
            return
        for found in find_recordings([f"@{path}"]):
            expect(found.exists(), f"{found} is not there")
    else:
        (read_tum, read_path, read_movingai_map, read_movingai_scen)[kind](path)


def line_seeds() -> list[bytes]:
    """One of each."""
    return [
        b"\0# t x y z qx qy qz qw\n1.5 0 0 0 0 0 0 1\n2.123456789 1 2 3 0 0 0.7 0.7\n",
        b"\1x_m,y_m\n0,0\n1.5,2\n",
        b"\0010,0\n1,1\n",
        b"\2type octile\nheight 3\nwidth 4\nmap\n..@.\nT.W.\n....\n",
        b"\3version 1\n0\ta.map\t4\t3\t0\t0\t3\t2\t4.24264\n",
        b"\4case.map\n# a comment\n*.map\n",
    ]


LINE_TOKENS = (b"nan", b"inf", b"1e400", b"-1", b"99999999999", b"\xef\xbb\xbf", b"\0", b"**", b"[!a]", b'"')


_PASSWORD = re.compile(r"(?:https?|s3)://[A-Za-z0-9]*:([A-Za-z0-9]{5,})@")


def urls(folder: Path, data: bytes) -> None:
    """Any text as a place, and within a text: its user, password and query never show."""
    text = data.decode("utf-8", "replace")
    redacted_text(text)
    if not is_url(text):
        return
    path = to_path(text)
    shown = f"{path} {redacted(text)} {path!r}"
    found = _PASSWORD.match(text)
    told_once = found is not None and text.count(found[1]) == 1
    expect(not told_once or found[1] not in shown, f"the password of {text!r} shows in {shown!r}")


def url_seeds() -> list[bytes]:
    """Stores, web servers, files, with and without secrets."""
    found = ["https://user:passw0rd@host:80/a/b.mcap?X-Sig=abcd&x=1#f", "s3://key:secret@bucket/a.mcap"]
    found += ["file:///tmp/a%20b.mcap", "abfs://c@account.net/a.mcap?sv=1&sig=abcd", "gs://bucket/folder/*.mcap"]
    return [each.encode() for each in [*found, "memory://a/b", "zip://a.mcap::https://h/a.zip"]]


URL_TOKENS = (b"://", b"@", b":", b"?", b"=", b"%2F", b"%", b"[::1]", b"::", b"..", b"file://")
