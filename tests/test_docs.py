"""Whatever README and docs/ have a reader type is typed here once, in one folder, and printed samples are compared."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import threading
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from distributed import LocalCluster
from mcap.reader import make_reader

from quadlog.cli.main import COMMANDS, run
from quadlog.config.schema import Config
from quadlog.pipelines.executor.pool import LocalPool
from quadlog.pipelines.executor.progress import send_to
from quadlog.results import figures
from tests.lab.recordings import written

ROOT = Path(__file__).parents[1]
MAKEFILE = (ROOT / "Makefile").read_text()
DEMO = re.search(r"\ndemo:.*?\$\(BIN\)/(quadlog replay .*?)\n", MAKEFILE, re.DOTALL)[1].replace(" -o runs", "")
PAGES = (
    "README.md",
    "docs/tutorial.md",
    *sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md") if path.stem != "tutorial"),
    "CONTRIBUTING.md",
)
BLOCK = re.compile(r"^```([\w{}-]*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
BLOCKS = {page: BLOCK.findall((ROOT / page).read_text()) for page in PAGES}
CLUSTERS = "docs/scaling.md"
SCHEDULER = "tcp://10.0.0.1:8786"  # a reader has an address of their own
REMOTE = re.compile(r"s3://|dask|--scheduler")
SHORTER = {"20": "0.5", "30": "0.5", "line": "short.csv"}
"""Seconds that a page takes of yesterday's log, and makes of a recording, which is short here; a course."""
BESIDE = Path(sys.executable).parent  # where quadlog and evo_ape are installed
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]


def lines_of(block: str) -> Iterator[tuple[str, set[int]]]:
    """Each command of a block without its comment, and the exit codes that the comment allows."""
    for line in block.splitlines():
        command, _, comment = line.partition("  #")
        said = re.search(r"exits with (\d)", comment)
        if command.strip():
            yield command.strip(), {int(said[1])} if said else {0, 3}


def fill_in() -> None:
    """What the README has its reader put below what init wrote, and the topic of the true pose."""
    given = tomllib.loads(Path("site.toml").read_text())
    tables = [(name, table) for name in ("anchors", "tags") for table in given["uwb"][name]]
    lines = [f"[[uwb.{name}]]\n{tomli_w.dumps(table)}" for name, table in tables]
    reference = f"[topics]\nreference = {json.dumps(given['topics']['reference'])}"
    Path("quadlog.toml").write_text(
        "\n".join([Path("quadlog.toml").read_text().replace("[topics]", reference, 1), *lines])
    )


AFTER = {
    "quadlog init yesterday.bag": fill_in,
    "quadlog replay yesterday.bag -c quadlog.toml": lambda: shutil.copy("runs/yesterday/reference.tum", "truth.tum"),
}
"""What a reader does between two commands."""


@dataclass
class Reader:
    """Types the pages. printed: command -> what it printed; wrong: what was not as a page has it."""

    printed: dict[str, str] = field(default_factory=dict)
    wrong: list[str] = field(default_factory=list)

    def read(self, page: str, remote: bool = False) -> None:
        """All blocks of a page; remote: only the commands that need a cluster or object storage, or none of them."""
        said = ""
        for language, block in BLOCKS[page]:
            if language == "sh":
                lines = [(line, codes) for line, codes in lines_of(block) if bool(REMOTE.search(line)) == remote]
                said = "\n".join(self.type(page, line, codes) for line, codes in lines)
            elif language == "text" and not remote:
                self.wrong += [f"{page}: not printed: {line}" for line in missing(block, said)]
            elif language == "python":
                exec(compile(block, page, "exec"), {})
            elif language == "toml" and "[project" not in block:
                Config.model_validate(tomllib.loads(block))

    def type(self, page: str, line: str, codes: set[int]) -> str:
        """What the line printed; a line of several pages is typed once."""
        line = " ".join(line.split()).replace("make demo", DEMO)
        if line not in self.printed:
            printed = io.StringIO()
            with redirect_stdout(printed), redirect_stderr(printed):
                code = shell(line)
            self.printed[line] = printed.getvalue()
            AFTER.get(line, lambda: None)()
            if code not in codes:
                self.wrong.append(f"{page}: {line}: exit {code}: {self.printed[line][-500:]}")
        return self.printed[line]


def missing(sample: str, printed: str) -> list[str]:
    """Lines of a sample that were not printed in this order; numbers may differ by what a processor rounds.

    `python docs/samples.py` writes the samples again.
    """
    rows = [row.split() for row in printed.splitlines()]
    lost = []
    for line in filter(None, map(str.strip, sample.splitlines())):
        at = next((number for number, row in enumerate(rows) if alike(line.split(), row)), None)
        lost += [line] if at is None else []
        rows = rows[at + 1 :] if at is not None else rows
    return lost


def alike(told: list[str], row: list[str]) -> bool:
    """Whether words are the same, and numbers nearly."""
    return len(told) == len(row) and all(
        one in (other, "…") or number(one) == pytest.approx(number(other), rel=0.02, abs=0.0005)
        for one, other in zip(told, row, strict=True)
    )


def number(word: str) -> float:
    found = re.fullmatch(r"[(±+]*([-−]?\d+(?:\.\d+)?)[),.;:%]*", word)
    return float(found[1].replace("−", "-")) if found else float("nan")


def shell(line: str) -> int:
    """Exit code of the line in a reader's shell, without a network; ValueError for what nobody here runs."""
    words = shlex.split(line)
    if words[0] == "quadlog":
        with cluster_of(words) as typed:
            # No page says a thing of a run's pictures, nor of walks of a season, which take most of their time.
            plain = ["--no-plots"] if typed[1] == "replay" else []
            plain += ["--until", "plan"] if "bags/" in typed else []
            return run([*(SHORTER.get(word, word) for word in typed[1:]), *plain])
    if words[0] == "make":
        return 0 if f"\n{words[1]}:" in MAKEFILE else 2
    if words[0] == "dask":
        return 0 if has_options(words) else 2
    if words[:2] == ["pip", "install"]:  # from a checkout: quadlog is on no index
        extra = re.fullmatch(r"\.\[(\w+)\]", words[2])
        return 0 if (extra and extra[1] in EXTRAS) or (ROOT / words[2] / "pyproject.toml").is_file() else 1
    if words[0] in ("eval", "evo_ape"):
        environment = {**os.environ, "PATH": f"{BESIDE}{os.pathsep}{os.environ['PATH']}", "HOME": str(Path.cwd())}
        asked = f"{line} && complete -p quadlog" if words[0] == "eval" else line
        return subprocess.run(["bash", "-c", asked], env=environment, capture_output=True, check=False).returncode
    raise ValueError(f"nobody runs {line!r}")


@contextmanager
def cluster_of(words: list[str]) -> Iterator[list[str]]:
    """The words of a command with the address of a real cluster of one worker, where they name one."""
    if SCHEDULER not in words:
        yield words
        return
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        yield [cluster.scheduler_address if word == SCHEDULER else word for word in words]


def has_options(words: list[str]) -> bool:
    """Whether a command of Dask's knows every option of the line."""
    module = import_module(f"distributed.cli.dask_{words[1]}")
    known = {name for parameter in module.main.params for name in parameter.opts}
    return {word for word in words[2:] if word.startswith("--")} <= known


ONE = threading.Lock()


def here(pool: LocalPool, call: Callable[..., Any], *args: Any, **options: Any) -> Any:
    """Does a task of a batch in this process, one at a time: to start workers takes longer than their short tasks."""
    with ONE:
        send_to(pool.messages.put)
        return call(*args, **options)


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Reader]:
    """One who has typed everything, in a folder with a log of yesterday's and two more, its truth, and the checkout."""
    folder, reader = tmp_path_factory.mktemp("reader"), Reader()
    made = folder / "made.mcap"
    assert run(["synthesize", "follow", "-o", str(made), "--duration", "1.5", "--azimuth-steps", "120",
                "--config-output", str(folder / "site.toml")]) == 0  # fmt: skip
    with made.open("rb") as file:
        rows = [(c.topic, m.log_time, schema.name, m.data) for schema, c, m in make_reader(file).iter_messages()]
    log = written(folder / "yesterday.bag", rows)
    (folder / "bags").mkdir()
    for name in ("one.bag", "two.bag"):
        shutil.copy(log, folder / "bags" / name)
    for name in ("fixtures", "examples"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "short.csv").write_text("x_m,y_m\n0,0\n0.3,0\n0.6,0\n")
    (folder / "walk.mcap").symlink_to(ROOT / "fixtures" / "follow.mcap")
    walk = tomllib.loads((ROOT / "fixtures" / "follow.toml").read_text())
    (folder / "walk.toml").write_text(tomli_w.dumps(walk | {"uwb": {"tags": walk["uwb"]["tags"]}}))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(LocalPool, "_do", here)
        patch.setattr(figures, "FIGURES", figures.FIGURES[:1])  # one stands for all, each of which has a test
        for page in PAGES:
            reader.read(page)
        yield reader


def test_every_command_works_and_every_sample_is_what_it_prints(reader):
    assert reader.wrong == []
    words = [shlex.split(line)[:2] for line in reader.printed]
    assert {"tables"} >= set(COMMANDS) - {second for first, second in words if first == "quadlog"}


@pytest.mark.nightly
def test_every_command_for_clusters_and_object_storage_works(reader, bucket):
    bucket.mkdir("lab")
    bucket.put_file("yesterday.bag", "lab/season/monday.mcap")
    reader.read(CLUSTERS, remote=True)
    assert reader.wrong == []
