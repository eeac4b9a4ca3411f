"""What every command promises: help, usage, errors in one line, outputs that spare what is there, and quiet ends."""

from __future__ import annotations

import os
import shlex
import shutil
import stat
import subprocess
import sys
from importlib.metadata import version

import click
import pytest
from click.testing import CliRunner

from quadlog.cli.main import COMMANDS, cli, run
from quadlog.plugins import DECODERS, PLANNERS
from quadlog.version import __version__
from tests.cli.conftest import FIXTURES
from tests.lab import recordings

HEAVY = ("numpy", "scipy", "pandas", "pyarrow", "matplotlib", "numba", "pydantic", "rich", "rosbags", "mcap", "open3d")
HEAVY += ("mujoco", "foxglove")
BUILT_ON = ("daqp", "foxglove-sdk", "mcap", "mujoco", "numba", "numpy", "pandas", "pyarrow", "scipy")
LINES = 40  # of a terminal: longer help scrolls off

READS = {
    "info": "info FILE",
    "init": "init FILE -o OUT",
    "replay": "replay FILE -o OUT",
    "sweep": "sweep FILE --set planner.name=astar -o OUT",
    "survey": "survey FILE -o OUT",
    "compare-planners": "compare-planners FILE -o OUT",
    "simulate": "simulate FILE -o OUT",
    "metrics": "metrics FILE",
    "report": "report FILE",
    "export": "export FILE --to tum -o OUT",
    "diff": "diff RUN FILE",
    "check": "check FILE --expect bounds.toml",
}
WRITES = {
    "export tum": "export RUN --to tum -o OUT",
    "check --write": "check RUN --expect OUT --write",
    "check --junit": "check RUN --expect bounds.toml --junit OUT",
    "init": "init LOG -o OUT",
    "survey": "survey LOG -o OUT",
    "synthesize": "synthesize follow -o OUT",
    "synthesize --config-output": "synthesize follow -o new.mcap --config-output OUT",
    "report": "report RUN OTHER --side-by-side -o OUT",
}
WRITES_LOCALLY = ["init LOG -o URL", "report URL", "simulate circle -o URL", "tables -o URL"]
WRITES_LOCALLY += ["synthesize follow -o URL", "export RUN --to tum -o URL"]


@pytest.fixture
def here(follow, tmp_path, monkeypatch):
    """Makes the words of a line of a table, in a folder with a run and a copy of it, which is the working one."""
    monkeypatch.chdir(tmp_path)
    places = {"RUN": shutil.copytree(follow, tmp_path / "run"), "OTHER": shutil.copytree(follow, tmp_path / "other")}

    def words(line, **given):
        known = places | {"LOG": FIXTURES / "follow.mcap", "OUT": "out"} | given
        return [str(known.get(word, word)) for word in line.split()]

    return words


def command_of(name):
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    return command


def test_no_help_imports_anything_heavy():
    code = (
        "import sys\nfrom quadlog.cli.main import COMMANDS, run\n"
        "for arguments in [['--help'], ['--version'], *([name, '--help'] for name in COMMANDS)]:\n"
        "    assert run(arguments) == 0\n"
        f"    assert not (found := {{*{HEAVY!r}}} & {{*sys.modules}}), (arguments, found)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.stderr, done.returncode) == ("", 0)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_fits_a_screen_and_ends_with_examples_that_the_command_takes(name, refused):
    command = command_of(name)
    assert command.name == name
    assert not command.get_short_help_str(56).endswith("..."), "its first sentence fits the list of commands"
    shown = CliRunner().invoke(cli, [name, "--help"], terminal_width=80).output
    assert len(shown.splitlines()) <= LINES
    assert max(map(len, shown.splitlines())) <= 80
    examples = shown[shown.index("\n  Examples:\n") :].splitlines()[2:]
    assert examples
    for example in examples:
        program, typed, *arguments = shlex.split(example)
        assert (program, typed) == ("quadlog", name)
        assert command.make_context(name, arguments).params
    if any(each.required for each in command.params):
        refused(2, name)


@pytest.mark.parametrize("line", READS.values(), ids=READS)
def test_what_is_not_there_or_hostile_is_one_line_and_nothing_is_written(line, here, quadlog, tmp_path):
    (tmp_path / "noise.mcap").write_bytes(bytes(range(256)) * 40)
    (tmp_path / "not\x1b[31mthere").mkdir()
    (tmp_path / "not\x1b[31mthere" / "run.json").write_text("[" * 10_000)
    for name in ("nowhere.mcap", "noise.mcap", "not\x1b[31mthere"):
        code, out, err = quadlog(*here(line, FILE=name))
        assert code in (1, 2), err
        assert "Traceback" not in err
        assert "\x1b" not in out + err
        if not line.startswith("sweep"):
            assert (out, err.splitlines()[-1].startswith(("quadlog: ", "Error: "))) == ("", True), err
        assert not (tmp_path / "out" / "run.json").exists()


@pytest.mark.parametrize("line", [*WRITES_LOCALLY, "metrics URL", "replay LOG -o URL"])
def test_files_that_are_written_locally_only_take_no_url_and_an_unset_variable_is_no_folder(line, here, refused):
    if line in WRITES_LOCALLY:
        assert "a local path is required here" in refused(2, *here(line, URL="s3://lab/x"))
    assert "the path is empty" in refused(2, *here(line, URL=""))


@pytest.fixture
def season(here, tmp_path):
    """Recordings of every form, a folder of runs, and a pipe and a link: {what is there: why no output goes there}."""
    shutil.copytree(tmp_path / "run", tmp_path / "season" / "run")
    recordings.build("split", tmp_path / "bag", recordings.some())
    recordings.build("bag", tmp_path / "bag.bin", recordings.some())
    recordings.build("mcap", tmp_path / "theirs.mcap", recordings.some())
    for name in ("season/summary.parquet", "season/report.html", "bag/metadata.yaml", "damaged.db3", "bounds.toml"):
        (tmp_path / name).write_text("mine")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/null")
    whys = dict.fromkeys(("run/run.json", "run/poses.parquet", "run/plots/trajectory.png"), "a file of the run")
    whys |= dict.fromkeys(("season/summary.parquet", "season/report.html"), "a file of the folder of results")
    whys |= dict.fromkeys(("bag.bin", "theirs.mcap", "damaged.db3"), "is a recording")
    return whys | {"pipe": "it is no regular file", "link": "it is a link"}


@pytest.mark.parametrize("line", WRITES.values(), ids=WRITES)
def test_no_output_replaces_an_input_a_recording_a_file_of_runs_a_pipe_or_a_link(line, season, here, refused, tmp_path):
    reads = {"LOG": "bag/metadata.yaml", "bounds.toml": "bounds.toml", "new.mcap": "new.mcap"}
    season |= {reads[word]: "is an input of this command" for word in line.split() if word in reads}
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for name, why in season.items():
        code = 1 if why.startswith("it is") else 2
        for force in ([], ["--force"])[2 - code :]:
            assert why in refused(code, *here(line, OUT=name, LOG="bag"), *force)
    refused(2, *here("export RUN --to rosmap -o run --force"))
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)
    assert (tmp_path / "link").is_symlink()
    assert {path: path.read_bytes() for path in before} == before


def test_what_else_is_read_or_belongs_to_others_is_spared_and_what_is_a_commands_own_replaced(
    here, refused, ok, tmp_path
):
    for name in ("quadlog.toml", "poses.tum", "sweep.parquet", "report.html"):
        (tmp_path / name).write_text("")
    for name in ("quadlog.toml", "poses.tum"):
        survey = f"survey LOG -c quadlog.toml --set topics.position=poses.tum --force -o {name}"
        assert "is an input of this command" in refused(2, *here(survey))
    for line in ("compare-planners forest:0.1 --episodes 1 -o .", "tables foot-drift --fast -o ."):
        assert "a file of the folder of results" in refused(2, *here(line), "--force")
    for line in ("synthesize follow --duration 0.3 -o own.mcap", "export RUN --to mcap -o own.mcap"):
        ok(*here(line), "--force")
    assert "is a recording" in refused(2, *here("export RUN --to tum -o own.mcap --force"))


def test_files_beside_the_runs_are_skipped_wherever_they_stand(follow, tmp_path, quadlog, refused):
    """As `runs/*` of a shell gives them: sorted, the page and the summary between the run folders."""
    shutil.copytree(follow, tmp_path / "zebra")
    for name in ("report.html", "notes.txt"):
        (tmp_path / name).write_text("")
    given = sorted(tmp_path.iterdir())
    bounds = ["--expect", tmp_path / "bounds.toml"]
    skipped = f"skipped, not a run folder: {tmp_path / 'notes.txt'}, {tmp_path / 'report.html'}"
    for words in (["metrics", *given], ["check", *given, *bounds, "--write"], ["check", *given, *bounds]):
        code, _, err = quadlog(*words)
        assert (code, err.splitlines()[0]) == (0, skipped)
    assert quadlog("report", *given) == (0, f"{tmp_path / 'zebra' / 'report.html'}\n", f"{skipped}\n")
    for command in ("metrics", "report"):
        assert "notes.txt: is no folder" in refused(1, command, tmp_path / "notes.txt")


def test_versions_are_quadlogs_and_those_of_its_packages_and_plugins(install, ok, capsys):
    points = {PLANNERS: {"zigzag": "zig:Zigzag", "astar": "zig:A"}, DECODERS: {"a.B": "zig:b"}}
    install("quadlog-zig", "0.7", points, {"zig": "raise SystemExit(9)"})
    first, *rest = ok("--version").splitlines()
    assert first == f"quadlog, version {__version__}"
    assert rest[-3:] == [f"{each}: quadlog-zig 0.7" for each in ("planner astar", "planner zigzag", "decoder a.B")]
    told = dict(line.split() for line in rest[:-3])
    assert told["python"] == sys.version.split()[0]
    assert {name: told[name] for name in BUILT_ON} == {name: version(name) for name in BUILT_ON}


def test_standard_streams_that_the_shell_closed_are_no_bug():
    command = f"{shlex.quote(sys.executable)} -m quadlog"
    script = f"{command} --help | head -n 1; {command} --help >&- && {command} --help <&- >&- 2>&- && {command} -q >&-"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "Usage: quadlog [OPTIONS] COMMAND [ARGS]...\n")
    assert done.stderr.splitlines()[-1] == "Error: No such option '-q'."
    assert done.stderr.startswith("Usage: ")


def test_code_that_cannot_be_kept_is_compiled_in_memory(tmp_path):
    """A read-only installation without a writable home: numba finds no folder."""
    (tmp_path / "file").touch()
    (tmp_path / "kernels.py").write_text(
        "from quadlog.compiled import kernel\n@kernel\ndef double(x):\n    return 2 * x\n"
        "@kernel\ndef half(x):\n    return x / 2\nprint(half(double(3)))"
    )
    command, place = [sys.executable, str(tmp_path / "kernels.py")], str(tmp_path / "file" / "in")
    env = os.environ | {"NUMBA_CACHE_LOCATOR_CLASSES": "UserProvidedCacheLocator", "NUMBA_CACHE_DIR": place}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=env)
    assert (done.stdout, done.stderr.count("\n"), "NUMBA_CACHE_DIR" in done.stderr) == ("3.0\n", 1, True)


def failing(monkeypatch, error):
    def fail(*_arguments, **_options):
        raise error

    monkeypatch.setattr(cli, "main", fail)


@pytest.mark.parametrize("error", [MemoryError("no room\nfor an array"), OSError(12, "no memory"), ValueError("bug")])
def test_a_lack_of_memory_is_one_line_and_a_bug_is_a_traceback(error, monkeypatch, refused):
    failing(monkeypatch, error)
    if isinstance(error, ValueError):
        with pytest.raises(ValueError, match="bug"):
            run(["info"])
    else:
        assert "memory" in refused(1, "info")


@pytest.mark.parametrize("name", COMMANDS)
def test_an_interrupted_command_says_how_to_go_on_where_that_can_be(name, monkeypatch, refused):
    failing(monkeypatch, KeyboardInterrupt())
    said = refused(1, name)
    assert said.startswith("quadlog: interrupted; nothing half-written was left")
    assert ("--resume" in said) == any("--resume" in option.opts for option in command_of(name).params)


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("repaly walk.mcap", "replay"),
        ("info folow.mcap", "follow.mcap"),
        ("replay folow.mcap", "follow.mcap"),
        ("replay follow.mcap -c folow.toml", "follow.toml"),
        ("metrics rums", "runs"),
        ("info nothing-alike", ""),
    ],
)
def test_a_mistyped_name_is_answered_by_the_nearest_one(line, meant, tmp_path, monkeypatch, quadlog):
    monkeypatch.chdir(tmp_path)
    for name in ("follow.mcap", "follow.toml", "runs"):
        (tmp_path / name).touch()
    done = quadlog(*line.split())
    assert done.code in (1, 2)
    assert (f"id you mean {meant}?" in done.err) if meant else ("did you mean" not in done.err), done.err
