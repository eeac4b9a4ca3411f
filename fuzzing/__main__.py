"""`make fuzz`: every target for its share of the time.

python -m fuzzing --seconds 600 --seed 0 [TARGET...]       exit 1 at a finding, with its file and how to see it again
python -m fuzzing replay FILE...                           the cases in files, of the target that names their folder
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

from fuzzing.worker import FOUND, Journal, fuzz, replay

FOLDER = Path(".fuzz")
_GRACE_S = 180


def main() -> int:
    """Dispatch; `one` is what the driver starts as a process."""
    parser = argparse.ArgumentParser(prog="python -m fuzzing", description=__doc__)
    parser.add_argument("words", nargs="*", metavar="TARGET", help="Of fuzzing/targets/table.py; all by default.")
    parser.add_argument("--seconds", type=float, default=600, help="Time for all targets together.")
    parser.add_argument("--seed", type=int, default=0, help="The same seed tries the same inputs.")
    parser.add_argument("--hypothesis", action="store_true", help="Mutate blindly also where atheris is installed.")
    given = parser.parse_args()
    guided = not given.hypothesis and importlib.util.find_spec("atheris") is not None
    match given.words:
        case ["one", name]:
            fuzz(name, given.seconds, given.seed, FOLDER / name, guided)
            return 0
        case ["replay", *files]:
            with TemporaryDirectory(prefix="quadlog-fuzz-") as scratch:
                replay(list(map(Path, files)), Path(scratch))
            return 0
    from fuzzing.targets.table import TARGETS  # not before: atheris instruments what `one` imports

    if unknown := sorted(set(given.words) - set(TARGETS)):
        parser.error(f"no target {', '.join(unknown)}; there are {', '.join(TARGETS)}")
    return _drive(given.words or list(TARGETS), given.seconds, given.seed, guided)


def _drive(names: list[str], seconds: float, seed: int, guided: bool) -> int:
    shutil.rmtree(FOLDER, ignore_errors=True)
    print(f"{'atheris' if guided else 'hypothesis'}, seed {seed}, {seconds / len(names):.0f} s for each target")
    found = [path for name in names if (path := _run(name, seconds / len(names), seed, guided)) is not None]
    for path in found:
        print(f"FOUND {path}\n  again: {sys.executable} -m fuzzing replay {path}")
    return 1 if found else 0


def _run(name: str, seconds: float, seed: int, guided: bool) -> Path | None:
    """One target; the file of its finding, None when there was none."""
    command = [sys.executable, "-m", "fuzzing", "one", name, "--seconds", str(seconds), "--seed", str(seed)]
    folder = FOLDER / name
    folder.mkdir(parents=True)
    log, started_s = folder / "log", monotonic()
    with log.open("wb") as out:
        process = subprocess.Popen(command if guided else [*command, "--hypothesis"], stdout=out, stderr=out)
        try:
            code: int | str = process.wait(seconds + _GRACE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            code = "the time limit"
    cases, last = Journal.read(folder / "journal")
    print(f"{name:12} {cases:9} cases {cases / (monotonic() - started_s):8.1f} /s", flush=True)
    if code == 0:
        return None
    path = folder / f"found-{hashlib.sha256(last).hexdigest()[:12]}"
    path.write_bytes(last)
    print(f"  {'finding' if code == FOUND else f'ended by {code}'}; {log} ends:")
    for line in log.read_text(errors="replace").splitlines()[-12:]:
        print(f"    {line}")
    return path


if __name__ == "__main__":
    sys.exit(main())
