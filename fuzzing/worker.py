"""One target in a process of its own: cases from a file, from atheris, or from hypothesis."""

from __future__ import annotations

import hashlib
import mmap
import os
import signal
import sys
import traceback
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from time import monotonic

os.environ.setdefault("ARROW_DEFAULT_MEMORY_POOL", "system")  # the others reserve address space by the gigabyte
os.environ["MUJOCO_GL"] = "disable"

_GUIDING = ("quadlog/recordings", "quadlog/storage", "quadlog/results", "quadlog/config/file.py")
"""What guides the search; nothing with compiled functions, whose bytecode numba has to read."""
_INSTRUMENTED_IS_SLOWER = 3
_LONGEST_BYTES = 1 << 16
_KEPT_EXAMPLES = 300
FOUND = 77


class Journal:
    """A file that says how many cases ran and holds the one that runs now, whatever becomes of this process."""

    HEAD = 16

    def __init__(self, path: Path) -> None:
        with path.open("w+b") as file:
            file.truncate(self.HEAD + (1 << 20))
            self._map = mmap.mmap(file.fileno(), 0)
        self.cases = 0

    def begin(self, data: bytes) -> None:
        """A case is about to run."""
        self.cases += 1
        data = data[: 1 << 20]
        self._map[self.HEAD : self.HEAD + len(data)] = data
        self._map[: self.HEAD] = self.cases.to_bytes(8, "little") + len(data).to_bytes(8, "little")

    @classmethod
    def read(cls, path: Path) -> tuple[int, bytes]:
        """How many cases ran, and the last one."""
        told = path.read_bytes() if path.exists() else bytes(cls.HEAD)
        length = int.from_bytes(told[8:16], "little")
        return int.from_bytes(told[:8], "little"), told[cls.HEAD : cls.HEAD + length]


def replay(name: str, paths: Iterable[Path], scratch: Path) -> int:
    """Run the cases in files; 0 when all hold, and FOUND at the first that does not."""
    run = _prepared(name, scratch)
    for path in paths:
        try:
            run(path.read_bytes(), 1)
        except BaseException:
            print(f"{path}:\n{_shortened()}", file=sys.stderr)
            return FOUND
    return 0


def test(names: Sequence[str], corpus: Path, scratch: Path) -> int:
    """Every case that broke something once, and a few mutations, of several targets; as replay."""
    from fuzzing.targets.table import TARGETS

    for name in names or TARGETS:
        kept = sorted((corpus / name).iterdir()) if (corpus / name).is_dir() else []
        found = replay(name, kept, scratch) or _by_hypothesis(
            name, _prepared(name, scratch), 0, None, TARGETS[name].examples, None
        )
        if found:
            return found
    return 0


def fuzz(name: str, seconds: float, seed: int, folder: Path, guided: bool) -> int:
    """Run a target for so long: by atheris where `guided`, else by hypothesis; folder gets journal and corpus."""
    corpus = folder / "corpus"
    corpus.mkdir(parents=True)
    return (_by_atheris if guided else _by_hypothesis_for)(name, seconds, seed, corpus, Journal(folder / "journal"))


@cache
def _prepared(name: str, scratch: Path) -> Callable[[bytes, int], None]:
    """The target's case behind the oracles, after every seed ran once: what is imported or compiled then is no cost."""
    from fuzzing.oracles import check, limit_process
    from fuzzing.targets.table import TARGETS

    target = TARGETS[name]
    folder = scratch / name
    folder.mkdir()

    def case(data: bytes) -> None:
        target.case(folder, data)

    def run(data: bytes, slower: int) -> None:
        check(case, data, most_cpu_s=target.most_cpu_s * slower)

    for seed in target.seeds():
        check(case, seed, most_cpu_s=60)
    limit_process()
    return run


def _by_atheris(name: str, seconds: float, seed: int, corpus: Path, journal: Journal) -> int:
    import atheris

    with atheris.instrument_imports(include=["quadlog"], exclude=_not_guiding()):
        from fuzzing.targets.table import TARGETS

        run = _prepared(name, _scratch(corpus))
    seeds = corpus.parent / "seeds"
    seeds.mkdir()
    for number, content in enumerate(TARGETS[name].seeds()):
        (seeds / f"{number:03d}").write_bytes(content)

    def one_input(data: bytes) -> None:
        journal.begin(data)
        try:
            run(data, _INSTRUMENTED_IS_SLOWER)
        except BaseException:
            _tell()
            os._exit(FOUND)

    options = [
        f"-seed={seed + 1}",
        f"-max_total_time={max(1, round(seconds))}",
        f"-max_len={_LONGEST_BYTES}",
        "-rss_limit_mb=0",
    ]
    options += ["-timeout=120", "-verbosity=0", f"-artifact_prefix={corpus.parent}/"]
    if TARGETS[name].tokens:
        words = corpus.parent / "words"
        escaped = ("".join(f"\\x{byte:02x}" for byte in word) for word in TARGETS[name].tokens)
        words.write_text("".join(f'"{word}"\n' for word in escaped))
        options.append(f"-dict={words}")
    atheris.Setup([sys.argv[0], *options, str(corpus), str(seeds)], one_input)
    atheris.Fuzz()
    return 0


def _scratch(corpus: Path) -> Path:
    """Beside the corpus, where the next start removes it: this process may end at any point."""
    scratch = corpus.parent / "scratch"
    scratch.mkdir()
    return scratch


def _not_guiding() -> list[str]:
    """All other modules of quadlog by name: atheris includes no less than a whole package."""
    files = [path for top in ("quadlog", "cli", "pipelines") for path in sorted(Path(top).rglob("*.py"))]
    others = [path for path in files if not path.as_posix().startswith(_GUIDING) or "plots" in path.parts]
    names = [".".join(path.with_suffix("").parts).removesuffix(".__init__") for path in others]
    return [name if name.startswith("quadlog") else f"quadlog.{name}" for name in names]


def _by_hypothesis_for(name: str, seconds: float, seed: int, corpus: Path, journal: Journal) -> int:
    run = _prepared(name, _scratch(corpus))
    end = monotonic() + seconds
    while monotonic() < end:
        found = _by_hypothesis(name, run, seed, journal, 200, corpus, end)
        if found:
            return found
        seed += 1
    return 0


def _by_hypothesis(
    name: str,
    run: Callable[[bytes, int], None],
    seed: int,
    journal: Journal | None,
    examples: int,
    corpus: Path | None,
    end: float | None = None,
) -> int:
    import hypothesis

    from fuzzing.edits import mutations
    from fuzzing.targets.table import TARGETS

    target = TARGETS[name]

    @hypothesis.seed(seed)
    @hypothesis.settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=[hypothesis.Phase.generate],
        suppress_health_check=list(hypothesis.HealthCheck),
    )
    @hypothesis.given(mutations(target.seeds(), target.tokens))
    def example(data: bytes) -> None:
        if end is not None and monotonic() > end:
            return
        if journal is not None:
            journal.begin(data)
        if corpus is not None and journal is not None and journal.cases <= _KEPT_EXAMPLES:
            (corpus / hashlib.sha1(data).hexdigest()).write_bytes(data)
        try:
            run(data, 1)
        except BaseException:
            _tell()
            if journal is None:
                print(f"{name}: {data!r}"[:2000], file=sys.stderr, flush=True)
            os._exit(FOUND)

    example()
    return 0


def _tell() -> None:
    signal.setitimer(signal.ITIMER_PROF, 0)
    print(_shortened(), file=sys.stderr, flush=True)


def _shortened() -> str:
    """The traceback of what is handled now, without its middle where it is long."""
    lines = traceback.format_exc().splitlines()
    return "\n".join(line[:300] for line in (lines if len(lines) < 40 else [*lines[:4], "  ...", *lines[-30:]]))
