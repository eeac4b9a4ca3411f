"""Whatever README and docs/ tell a reader to type, typed, in one folder and in the order of the pages."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster
from mcap.reader import make_reader
from moto.server import ThreadedMotoServer
from s3fs import S3FileSystem

from quadlog.cli.main import COMMANDS, cli, run
from quadlog.config.file import PRESETS
from quadlog.config.planners import PLANNER_NAMES
from quadlog.config.schema import Config

ROOT = Path(__file__).parents[1]
MAKEFILE = (ROOT / "Makefile").read_text()
PAGES = ("README.md", *sorted(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md")), "CONTRIBUTING.md")
TEXTS = {page: (ROOT / page).read_text() for page in PAGES}
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
PROSE = {page: BLOCK.sub("", text) for page, text in TEXTS.items()}
INLINE = {(page, code) for page, text in PROSE.items() for code in re.findall(r"`([^`\n]+)`", text)}
# Less than the page asks for: seconds of a recording, the length of a course.
SHORTER = {"20": "0.5", "30": "0.5", "line": "short.csv"}
BESIDE = Path(sys.executable).parent  # where quadlog and evo_ape are installed
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
CLUSTERS = "docs/scaling.md"
SCHEDULER = "tcp://10.0.0.1:8786"  # a reader has an address of their own


def record(folder: str) -> dict:
    """run.json of the run of yesterday's log in a folder of runs."""
    return json.loads((Path(folder) / "yesterday" / "run.json").read_text())


def has(folder: str, *names: str) -> bool:
    """Whether yesterday's run has these files."""
    return all((Path(folder) / "yesterday" / name).is_file() for name in names)


def detected(_: str) -> bool:
    """Of init's file: topics are filled in, every other key is a comment with its default."""
    text = Path("quadlog.toml").read_text()
    live = {name: keys for name, keys in tomllib.loads(text).items() if any(each != {} for each in keys.values())}
    keys = set(re.findall(r"^(?:# )?(\w+) =", text, re.MULTILINE))
    sections = [field.annotation.model_fields for field in Config.model_fields.values()]
    plain = {key for each in sections for key, field in each.items() if not hasattr(field.annotation, "model_fields")}
    return (
        set(live) <= {"topics", "lidar"}
        and live["topics"]["lidar"] != ""
        and plain - keys <= {"anchors", "tags", "range_topics"}
    )


def like_the_paper(_: str) -> bool:
    """Every key of the preset is in force, whatever quadlog.toml says."""
    config = record("runs/paper")["config"]
    return all(config[name] | keys == config[name] for name, keys in PRESETS["paper"].items())


def eleven(_: str) -> bool:
    """Every planner has a row."""
    return sorted(pq.read_table("planners/planners.parquet")["planner"].to_pylist()) == sorted(PLANNER_NAMES)


def all_tables(_: str) -> bool:
    """Each table of the run is a CSV file of as many lines."""
    tables = sorted(Path("runs/yesterday").glob("*.parquet"))
    lines = {path.stem: len(path.read_text().splitlines()) - 1 for path in Path("yesterday-csv").glob("*.csv")}
    return lines == {path.stem: pq.read_metadata(path).num_rows for path in tables}


def walks(_: str) -> bool:
    """Two seeds on the terrain."""
    runs = [json.loads(path.read_text()) for path in sorted(Path("walks").glob("*-fpmw/seed-00[01]/run.json"))]
    return [each["config"]["simulation"]["terrain"] for each in runs] == ["3cm", "3cm"]


def truth(_: str) -> bool:
    """The recording's true poses."""
    with Path("truth.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    return {"/truth/robot/pose", "/truth/person/pose"} <= {each.topic for each in summary.channels.values()}


def both(folder: str) -> bool:
    """A run of each recording, and their table."""
    names = pq.read_table(f"{folder}/summary.parquet")["recording"].to_pylist()
    return sorted(names) == ["one", "two"] and all(Path(folder, name, "report.html").is_file() for name in names)


def kept(said: str) -> bool:
    """Of both runs all is reused."""
    return said.count("; reused 6 of 6 stages: ") == 2


def words(*each: str) -> Callable[[str], bool]:
    """Whether all of these are printed."""
    return lambda said: all(word in said for word in each)


# What the comment beside a command says, told by what it printed and left.
CLAIMS: dict[str, Callable[[str], bool]] = {
    "quadlog init yesterday.bag": detected,
    "quadlog replay yesterday.bag -c quadlog.toml -o runs/astar --planner astar": lambda _: (
        set(pq.read_table("runs/astar/yesterday/plans.parquet")["planner"].to_pylist()) == {"astar"}
    ),
    "quadlog replay yesterday.bag -c quadlog.toml -o runs/half --start 20 --duration 30": lambda _: (
        0.3 < record("runs/half")["recorded_s"] <= 0.5
    ),
    "quadlog replay yesterday.bag -c quadlog.toml -o runs/map --until map": lambda _: (
        has("runs/map", "maps.npz", "run.json", "report.html") and not has("runs/map", "plans.parquet")
    ),
    "quadlog replay bags/ -c quadlog.toml -o season/ --jobs 4": lambda _: both("season"),
    "quadlog replay yesterday.bag -c quadlog.toml -o runs/paper --preset paper": like_the_paper,
    "quadlog sweep yesterday.bag -c quadlog.toml --set planner.name=astar,ia_star -o both": lambda _: (
        pq.read_table("both/sweep.parquet")["planner.name"].to_pylist() == ["astar", "ia_star"]
    ),
    "quadlog compare-planners runs/yesterday -o planners": eleven,
    "quadlog replay yesterday.bag -c quadlog.toml -o runs/point --controller kinematic": lambda _: (
        has("runs/point", "control.parquet")
        and not {"torque_max_nm", "height_rms_m"}
        & set(json.loads(Path("runs/point/yesterday/metrics.json").read_text()))
    ),
    "quadlog metrics runs/yesterday runs/astar season": words("yesterday", "astar", "season/one", "season/two"),
    "quadlog metrics runs/yesterday --explain eta_m": words("eta_m", "worst"),
    "quadlog metrics runs/yesterday --reference truth.tum": words("ate_rmse_m", "rpe_rmse_m"),
    "quadlog export runs/yesterday --to csv": all_tables,
    "quadlog export runs/yesterday --to gif": lambda _: Path("yesterday-walk.gif").read_bytes().startswith(b"GIF89a"),
    "quadlog simulate line --terrain 3cm --seeds 2 -o walks": walks,
    "quadlog synthesize follow -o truth.mcap --duration 20": truth,
    "quadlog metrics runs/yesterday --fail-if 'success_rate<0.9'": lambda _: (
        run(["metrics", "runs/yesterday", "--fail-if", "success_rate>=0"]) == 4
    ),
    "quadlog check runs/yesterday --expect bounds.toml --write": lambda _: (
        "yesterday" in tomllib.loads(Path("bounds.toml").read_text())["recordings"]
    ),
    "quadlog check runs/yesterday --expect bounds.toml --junit checks.xml": lambda _: (
        "<testcase" in Path("checks.xml").read_text()
    ),
    "quadlog diff runs/yesterday runs/astar/yesterday --tolerance 1e-9": words("plan"),
    "quadlog replay bags/ -c quadlog.toml -o season --resume --dry-run": words(
        "skip", "0 of 2 to replay", "may be deleted"
    ),
    "quadlog replay bags/ -c quadlog.toml -o season --resume --jobs 4": kept,
    "quadlog --version": words("quadlog"),
    "quadlog metrics runs/yesterday": words("eta_m", "95 %"),
    "quadlog metrics --explain eta_m": words("eta_m"),
    "quadlog metrics runs/yesterday --explain success_rate": words("success_rate", "yesterday: "),
    "quadlog replay bags/ -o winter --dry-run": words("run ", "2 of 2 to replay", " MB", "unknown until"),
    "quadlog replay bags/ -o winter --jobs 4": lambda _: both("winter"),
    "quadlog replay bags/ -o winter --resume": kept,
}


def fill_in(config: Path, site: Path) -> None:
    """The anchors and tags that the README tells its reader to put into the file of init, and the true pose's topic."""
    given = tomllib.loads(site.read_text())
    text = config.read_text()
    for section, keys in (("topics", ["reference"]), ("uwb", ["anchors", "tags"])):
        lines = "".join(f"{key} = {inline(given[section][key])}\n" for key in keys)
        text = text.replace(f"[{section}]\n", f"[{section}]\n{lines}", 1)
    config.write_text(text)


def inline(value: object) -> str:
    """A text, a number, or a list of tables as one line of TOML."""
    if isinstance(value, list):
        return f"[{', '.join(map(inline, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key} = {inline(each)}' for key, each in value.items())}}}"
    return json.dumps(value)


def shell_lines(block: str) -> Iterator[tuple[str, tuple[int, ...]]]:
    """Each line without its comment, and the exit codes that the comment allows."""
    for line in block.splitlines():
        command, _, comment = line.partition("  #")
        said = re.search(r"exits with (\d)", comment)
        if command.strip():
            yield command.strip(), (int(said[1]),) if said else (0, 3)


@contextmanager
def cluster_of(words: list[str]) -> Iterator[list[str]]:
    """The words of a command with the address of a real cluster of one worker, where they name one."""
    if SCHEDULER not in words:
        yield words
        return
    with LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        yield [cluster.scheduler_address if word == SCHEDULER else word for word in words]


@contextmanager
def lab_bucket(log: Path) -> Iterator[None]:
    """The object storage that the pages speak of: s3://lab with a recording of Monday's."""
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("AWS_ENDPOINT_URL", "http://{}:{}".format(*server.get_host_and_port()))
            for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
                patch.setenv(name, "testing")
            S3FileSystem.clear_instance_cache()
            store = S3FileSystem()
            store.mkdir("lab")
            store.put_file(str(log), "lab/season/monday.mcap")
            yield
            S3FileSystem.clear_instance_cache()
    finally:
        server.stop()


def has_options(words: list[str]) -> bool:
    """Whether a command of Dask's knows every option of the line."""
    module = import_module(f"distributed.cli.dask_{words[1]}")
    known = {name for parameter in module.main.params for name in parameter.opts}
    return {word for word in words[2:] if word.startswith("--")} <= known


def do(line: str) -> tuple[int, str]:
    """Exit code and output of the line in a reader's shell; see shell."""
    printed = io.StringIO()
    with redirect_stdout(printed), redirect_stderr(printed):
        return shell(line), printed.getvalue()


def shell(line: str) -> int:
    """What a reader's shell would do with the line, without a network; ValueError for what nobody here runs."""
    words = shlex.split(line)
    with pytest.MonkeyPatch.context() as patch:
        while "=" in words[0] and words[0].startswith("QUADLOG_"):
            patch.setenv(*words.pop(0).split("=", 1))
        if words[0] == "quadlog":
            with cluster_of(words) as typed:
                # The first run of the tour has plots; of others nothing is said that plots show.
                plain = ["--no-plots"] if typed[1] == "replay" and Path("runs").exists() else []
                return run([*(SHORTER.get(word, word) for word in typed[1:]), *plain])
    if words[0] == "dask":
        return 0 if has_options(words) else 2
    if words[0] == "make":
        return 0 if f"\n{words[1]}:" in MAKEFILE else 2
    if words[:2] == ["pip", "install"] and (extra := re.fullmatch(r"\.\[(\w+)\]", words[2])):
        return 0 if extra[1] in EXTRAS else 1  # from a checkout: quadlog is on no index
    if words[:2] == ["pip", "install"]:
        return 0 if (ROOT / words[2] / "pyproject.toml").is_file() else 1
    if words[0] in ("eval", "evo_ape"):
        environment = {**os.environ, "PATH": f"{BESIDE}{os.pathsep}{os.environ['PATH']}", "HOME": str(Path.cwd())}
        asked = f"{line} && complete -p quadlog" if words[0] == "eval" else line
        return subprocess.run(["bash", "-c", asked], env=environment, capture_output=True, check=False).returncode
    raise ValueError(f"nobody runs {line!r}")


def tour(page: str) -> Iterator[str]:
    """Types everything on the page, and gives what did not do as the page says."""
    for language, block in BLOCK.findall(TEXTS[page]):
        if language == "sh":
            for line, allowed in shell_lines(block):
                code, said = do(line)
                if code not in allowed:
                    yield f"{page}: {line}: exit {code}: {said[-500:]}"
                elif line in CLAIMS and not CLAIMS[line](said):
                    yield f"{page}: {line}: does not do what its comment says: {said[-500:]}"
                if line == "quadlog init yesterday.bag":
                    fill_in(Path("quadlog.toml"), Path("site.toml"))
        elif language == "python":
            exec(compile(block, page, "exec"), {})
        elif language == "toml":
            tomllib.loads(block)
        elif language == "text":
            continue  # sample output: test_readme.py holds it to what is printed
        elif language or re.search(r"^(quadlog|make|pip) ", block, re.MULTILINE):
            yield f"{page}: a block of {language or 'no language'} that nobody runs"


@pytest.fixture(scope="module")
def toured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """The folder of a reader who typed it all, and what went wrong; at the start it holds a log, twice, and a truth."""
    folder = tmp_path_factory.mktemp("reader")
    log = folder / "yesterday.bag"
    site = ["--config-output", str(folder / "site.toml")]
    assert run(["synthesize", "follow", "-o", str(log), "--duration", "1.5", "--azimuth-steps", "120", *site]) == 0
    (folder / "bags").mkdir()
    for name in ("one.bag", "two.bag"):
        shutil.copy(log, folder / "bags" / name)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert run(["replay", "yesterday.bag", "-o", "truth", "--until", "position", "--no-plots"]) == 0
        shutil.move("truth/yesterday/trajectory.tum", "truth.tum")
        Path("short.csv").write_text("x_m,y_m\n0,0\n0.3,0\n0.6,0\n")
        return folder, [wrong for page in PAGES if page != CLUSTERS for wrong in tour(page)]


def test_every_command_of_every_page_does_what_it_says(toured):
    folder, wrong = toured
    assert wrong == []
    assert (folder / "season" / "summary.parquet").is_file()
    assert (folder / "checks.xml").is_file()


@pytest.mark.nightly
def test_every_command_for_clusters_and_object_storage_does_what_it_says(toured, monkeypatch):
    monkeypatch.chdir(toured[0])
    with lab_bucket(toured[0] / "yesterday.bag"):
        assert list(tour(CLUSTERS)) == []


def test_the_tour_is_long_enough_to_mean_something():
    lines = [line for page in PAGES for language, block in BLOCK.findall(TEXTS[page]) if language == "sh"
             for line, _ in shell_lines(block)]  # fmt: skip
    told = {shlex.split(line)[1] for line in lines if line.startswith("quadlog ")}
    assert len(lines) > 30
    assert {"report", "survey", "tables"} >= set(COMMANDS) - told, "these are run by tests of their own"


def test_every_comment_beside_a_command_is_checked():
    commented = {
        line.partition("  #")[0].strip() for page in PAGES for language, block in BLOCK.findall(TEXTS[page])
        for line in block.splitlines() if language == "sh" and line.startswith("quadlog ") and "  #" in line
    }  # fmt: skip
    assert commented == set(CLAIMS)


def test_the_files_that_the_readme_lists_are_the_files_there_are(toured):
    listed = TEXTS["README.md"].split("leaves `runs/yesterday/`:")[1].split("## Things to try")[0]
    names = re.findall(r"`([\w-]+\.(?:html|npz|tum|pgm|yaml|mcap|json|toml))`", listed)
    for row in re.findall(r"^\| (.*`\.parquet`.*?) \|", listed, re.MULTILINE):
        names += [f"{name}.parquet" for name in re.findall(r"`(\w+)`", row.split("`.parquet`")[0])]
    assert len(names) >= 21
    for name in names:
        assert (toured[0] / "runs" / "yesterday" / name).is_file(), name


@pytest.mark.parametrize("name", ["maps.npz", "cloud_samples.npz", "ground.npz"])
def test_the_members_of_an_archive_are_those_listed(toured, name):
    arrays = TEXTS["docs/files.md"].split("## Arrays")[1].split("##")[0]
    row = arrays.split(f"| `{name}` |")[1].splitlines()[0]
    names = {code.split()[0] for code in re.findall(r"`([^`]+)`", row)}
    with np.load(toured[0] / "runs" / "yesterday" / name) as archive:
        assert set(archive) <= names


def test_the_topics_of_derived_mcap_are_those_listed(toured):
    section = TEXTS["docs/files.md"].split("## derived.mcap")[1].split("##")[0]
    listed = dict(re.findall(r"^\| (`/.*?) \| (.*) \|$", section, re.MULTILINE))
    schema_of = {topic: schema for topics, schema in listed.items() for topic in re.findall(r"`([^`]+)`", topics)}
    with (toured[0] / "runs" / "yesterday" / "derived.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert len(summary.channels) >= 8
    for channel in summary.channels.values():
        said = schema_of[re.sub(r"/\d+$", "/TAG", re.sub(r"/\d+/\d+$", "/TAG/ANCHOR", channel.topic))]
        assert (summary.schemas[channel.schema_id].name if channel.message_encoding == "protobuf" else "JSON") in said


@pytest.mark.parametrize(("page", "code"), sorted(each for each in INLINE if each[1].startswith(("quadlog ", "make "))))
def test_what_is_mentioned_exists(page, code):
    first, *words = (word for word in code.split() if "=" not in word)
    if first == "make":
        assert f"\n{words[0]}:" in MAKEFILE
        return
    second, *rest = words
    if second in ("--help", "--version", "COMMAND"):
        return
    assert second in COMMANDS
    with cli.make_context("quadlog", [second], resilient_parsing=True) as ctx:
        command = cli.get_command(ctx, second)
    flags = {flag for parameter in command.params for flag in parameter.opts}
    assert {word for word in rest if word.startswith("-")} <= flags


@pytest.mark.parametrize(("page", "link"), [
    (page, link) for page, text in PROSE.items() for link in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in link
])  # fmt: skip
def test_every_link_leads_somewhere(page, link):
    assert ((ROOT / page).parent / link).exists()


@pytest.mark.parametrize(("page", "code"), sorted(
    each for each in INLINE if re.match(r"(quadlog|cli|pipelines|docs|tests|fixtures|examples)/", each[1])
))  # fmt: skip
def test_every_path_is_there(page, code):
    assert any(ROOT.glob(re.sub(r"NAME|PACKAGE|FOLDER", "*", code).rstrip("/"))), code


@pytest.mark.parametrize("page", PAGES)
def test_every_table_has_as_many_cells_in_each_row(page):
    for table in re.findall(r"(?:^\|.*\n)+", TEXTS[page], re.MULTILINE):
        assert len({len(re.findall(r"(?<!\\)\|", row)) for row in table.splitlines()}) == 1, table


def test_tables_to_add_a_line_to_are_where_they_are_said_to_be():
    said = re.findall(r"`(\w+)` (?:in|of) `([\w/]+\.py)`", TEXTS["docs/adding.md"])
    assert len(said) >= 8
    for name, path in said:
        assert re.search(rf"^{name}\b", (ROOT / path).read_text(), re.MULTILINE), (name, path)


def test_the_picture_of_the_house_names_what_is_there():
    picture = BLOCK.search(TEXTS["docs/architecture.md"])
    assert picture is not None
    tree = [path for top in ("quadlog", "cli", "pipelines", "docs") for path in (ROOT / top).rglob("*")]
    names = {path.name if path.is_dir() else path.stem for path in tree}
    for word in set(re.findall(r"\b[a-z0-9]+(?:_[a-z0-9]+)+\b", picture[2])) - {"map_server"}:
        assert word in names, word
    packages = {path.parent.name for path in tree if path.name == "__init__.py"}
    assert {name for name in packages if name not in picture[2]} == set()
    modules = {path.name for path in (ROOT / "quadlog").glob("*.py")} - {"__init__.py", "__main__.py", "version.py"}
    assert {name for name in modules if name not in picture[2]} == set()
