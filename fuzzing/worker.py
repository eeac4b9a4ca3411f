"""One target in a process of its own: cases from files, from atheris, or from hypothesis."""

from __future__ import annotations

import os
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from time import monotonic
from typing import NoReturn

os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # the others reserve address space by the gigabyte
os.environ["MUJOCO_GL"] = "disable"

FOUND = 77
_GUIDING = ("quadlog/recordings", "quadlog/storage", "quadlog/results", "quadlog/config/file.py")
"""What guides the search; nothing with compiled functions, whose bytecode numba has to read."""
_INSTRUMENTED_IS_SLOWER = 3
_LONGEST_BYTES = 1 << 16
Run = Callable[[bytes], None]


class Journal:
    """A file with the number of cases and the one that runs now, whatever becomes of this process."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC)
        self._cases = 0

    def begin(self, data: bytes) -> None:
        """A case is about to run."""
        self._cases += 1
        os.pwrite(self._file, self._cases.to_bytes(8, "little") + data, 0)
        os.ftruncate(self._file, 8 + len(data))

    @staticmethod
    def read(path: Path) -> tuple[int, bytes]:
        """How many cases ran, and the last one."""
        content = path.read_bytes() if path.exists() else b""
        return int.from_bytes(content[:8], "little"), content[8:]


def prepare(name: str, scratch: Path, slower: int = 1, warm: Sequence[bytes] = ()) -> Run:
    """The target's case behind the oracles, after these inputs or every seed ran once: imports are no cost."""
    from fuzzing.oracles import check, limit_process
    from fuzzing.targets.table import TARGETS

    target = TARGETS[name]
    folder = scratch / name
    folder.mkdir()

    def case(data: bytes) -> None:
        target.case(folder, data)

    for data in warm or target.seeds():
        check(case, data, most_cpu_s=60)
    limit_process()
    return lambda data: check(case, data, target.most_cpu_s * slower)


def replay(paths: Sequence[Path], scratch: Path) -> None:
    """Run the cases in files, each of the target that names its folder; ends the process at the first that fails."""
    for path in paths:
        data, folder = path.read_bytes(), scratch / path.name
        folder.mkdir()
        run = prepare(path.parent.name, folder, warm=[data])
        try:
            run(data)
        except BaseException:
            print(f"{path}:", file=sys.stderr)
            _end_as_found()


def fuzz(name: str, seconds: float, seed: int, folder: Path, guided: bool) -> None:
    """Run a target for so long: by atheris where `guided`, else by hypothesis; folder gets the journal."""
    (_by_atheris if guided else _by_hypothesis)(name, seconds, seed, folder, Journal(folder / "journal"))


def one_input(run: Run, data: bytes, journal: Journal) -> None:
    """Run a case; ends the process where it does not hold."""
    journal.begin(data)
    try:
        run(data)
    except BaseException:
        print(f"{data!r}"[:2000], file=sys.stderr)
        _end_as_found()


def _by_atheris(name: str, seconds: float, seed: int, folder: Path, journal: Journal) -> None:
    import atheris

    with atheris.instrument_imports(include=["quadlog"], exclude=_not_guiding()):
        from fuzzing.targets.table import TARGETS

        run = prepare(name, folder, _INSTRUMENTED_IS_SLOWER)
    seeds = folder / "seeds"
    seeds.mkdir()
    for number, content in enumerate(TARGETS[name].seeds()):
        (seeds / f"{number:03d}").write_bytes(content)

    options = [f"-seed={seed + 1}", f"-max_total_time={max(1, round(seconds))}", f"-max_len={_LONGEST_BYTES}"]
    options += ["-rss_limit_mb=0", "-timeout=120", "-verbosity=0", f"-artifact_prefix={folder}/"]
    if TARGETS[name].tokens:
        words = folder / "words"
        escaped = ("".join(f"\\x{byte:02x}" for byte in word) for word in TARGETS[name].tokens)
        words.write_text("".join(f'"{word}"\n' for word in escaped))
        options.append(f"-dict={words}")
    atheris.Setup([sys.argv[0], *options, str(seeds)], lambda data: one_input(run, data, journal))
    atheris.Fuzz()


def _not_guiding() -> list[str]:
    """All other modules of quadlog by name: atheris includes no less than a whole package."""
    files = [path for top in ("quadlog", "cli", "pipelines") for path in sorted(Path(top).rglob("*.py"))]
    others = [path for path in files if not path.as_posix().startswith(_GUIDING)]
    names = [".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in others]
    return [name if name.startswith("quadlog") else f"quadlog.{name}" for name in names]


def _by_hypothesis(name: str, seconds: float, seed: int, folder: Path, journal: Journal) -> None:
    """Mutations of the target's seeds, two hundred at a time."""
    import hypothesis

    from fuzzing.edits import mutations
    from fuzzing.targets.table import TARGETS

    target, run = TARGETS[name], prepare(name, folder)
    end = monotonic() + seconds

    def example(data: bytes) -> None:
        if monotonic() < end:
            one_input(run, data, journal)

    settings = hypothesis.settings(
        max_examples=200,
        deadline=None,
        database=None,
        phases=[hypothesis.Phase.generate],
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    inputs = mutations(target.seeds(), target.tokens)
    while monotonic() < end:
        hypothesis.seed(seed)(settings(hypothesis.given(inputs)(example)))()
        seed += 1


def _end_as_found() -> NoReturn:
    """Print the traceback of what is handled now, without its middle where it is long, and end the process."""
    signal.setitimer(signal.ITIMER_PROF, 0)
    lines = traceback.format_exc().splitlines()
    shown = lines if len(lines) < 40 else [*lines[:4], "  ...", *lines[-30:]]
    print("\n".join(line[:300] for line in shown), file=sys.stderr, flush=True)
    os._exit(FOUND)
