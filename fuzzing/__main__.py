"""`make fuzz`: every target for its share of the time, then what was run and which lines it reached.

python -m fuzzing --seconds 600 --seed 0 [TARGET...]       exit 1 at a finding, with its file and how to see it again
python -m fuzzing replay TARGET FILE...                    the cases in files
python -m fuzzing test CORPUS [TARGET...]                  the cases in a folder, then a few mutations of the seeds
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic

from fuzzing.worker import FOUND, Journal, fuzz, replay, test

FOLDER = Path(".fuzz")
_MEASURED = ("quadlog/recordings", "quadlog/storage")
_GRACE_S = 180


def main() -> int:
    """Dispatch; `one` is what the driver starts as a process."""
    parser = argparse.ArgumentParser(prog="python -m fuzzing", description=__doc__)
    parser.add_argument("targets", nargs="*", metavar="TARGET", help="Of fuzzing/targets/table.py; all by default.")
    parser.add_argument("--seconds", type=float, default=600, help="Time for all targets together.")
    parser.add_argument("--seed", type=int, default=0, help="The same seed tries the same inputs.")
    parser.add_argument("--hypothesis", action="store_true", help="Mutate blindly also where atheris is installed.")
    asked = parser.parse_args()
    guided = not asked.hypothesis and importlib.util.find_spec("atheris") is not None
    if asked.targets[:1] == ["replay"]:
        name, *paths = asked.targets[1:]
        with TemporaryDirectory(prefix="quadlog-fuzz-") as scratch:
            return replay(name, _files(paths), Path(scratch))
    if asked.targets[:1] == ["test"]:
        with TemporaryDirectory(prefix="quadlog-fuzz-") as scratch:
            return test(asked.targets[2:], Path(asked.targets[1]), Path(scratch))
    if asked.targets[:1] == ["one"]:
        return fuzz(asked.targets[1], asked.seconds, asked.seed, FOLDER / asked.targets[1], guided)
    from fuzzing.targets.table import TARGETS  # not before: atheris instruments what `one` imports

    if unknown := sorted(set(asked.targets) - set(TARGETS)):
        parser.error(f"no target {', '.join(unknown)}; there are {', '.join(TARGETS)}")
    return _drive(asked.targets or list(TARGETS), asked.seconds, asked.seed, guided)


def _drive(names: list[str], seconds: float, seed: int, guided: bool) -> int:
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir()
    print(f"{'atheris' if guided else 'hypothesis'}, seed {seed}, {seconds / len(names):.0f} s for each target")
    found = [path for name in names if (path := _run(name, seconds / len(names), seed, guided)) is not None]
    _print_coverage(names)
    for path in found:
        print(f"FOUND {path}\n  again: {sys.executable} -m fuzzing replay {path.name.rpartition('-')[0]} {path}")
    return 1 if found else 0


def _run(name: str, seconds: float, seed: int, guided: bool) -> Path | None:
    """One target; the file of its finding, None when there was none."""
    command = [sys.executable, "-m", "fuzzing", "one", name, "--seconds", str(seconds), "--seed", str(seed)]
    log = FOLDER / f"{name}.log"
    started = monotonic()
    with log.open("wb") as out:
        process = subprocess.Popen(command if guided else [*command, "--hypothesis"], stdout=out, stderr=out)
        try:
            code: int | str = process.wait(seconds + _GRACE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            code = "killed: it went on for ever"
    cases, last = Journal.read(FOLDER / name / "journal")
    took_s = monotonic() - started
    print(f"{name:12} {cases:9} cases {cases / took_s:8.1f} /s", flush=True)
    if code == 0:
        return None
    path = FOLDER / f"{name}-{hashlib.sha256(last).hexdigest()[:12]}"
    path.write_bytes(last)
    print(f"  {'finding' if code == FOUND else f'ended with {code}'}; {log} ends:")
    for line in log.read_text(errors="replace").splitlines()[-12:]:
        print(f"    {line}")
    return path


def _print_coverage(names: list[str]) -> None:
    """Lines that the collected inputs reach, measured apart: counting lines while fuzzing would halve its speed."""
    if importlib.util.find_spec("coverage") is None:
        return
    data = FOLDER / "coverage"
    measure = [sys.executable, "-m", "coverage"]
    for name in names:
        inside = [f"--data-file={data}", "--append", f"--include={','.join(f'{each}/*' for each in _MEASURED)}"]
        corpus = FOLDER / name / "corpus"
        arguments = [*measure, "run", *inside, "-m", "fuzzing", "replay", name, str(corpus)]
        subprocess.run(arguments, check=False, capture_output=True)
    for each in _MEASURED:
        report = [*measure, "report", f"--data-file={data}", f"--include={each}/*", "--format=total"]
        total = subprocess.run(report, check=False, capture_output=True, text=True).stdout.strip()
        print(f"{each}: {total or '?'} % of lines")


def _files(paths: list[str]) -> list[Path]:
    """The files, and of folders the files in them."""
    found = [Path(path) for path in paths]
    return [file for path in found for file in (sorted(path.iterdir()) if path.is_dir() else [path])]


if __name__ == "__main__":
    sys.exit(main())
