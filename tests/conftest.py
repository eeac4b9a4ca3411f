"""What all tests share: how hypothesis draws, what has to be there, what is built once; plug-ins, stores, a walk."""

from __future__ import annotations

import fcntl
import os
import pickle
import shutil
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from quadlog import plugins
from quadlog.pipelines.executor import second_process
from tests.lab.web_server import WebServer, serve

if TYPE_CHECKING:
    from quadlog.simulation.synthetic.recording import SynthesizedRecording

Installer = Callable[..., Path]

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable"))), None
)
DATASETS = ("edge_cases", "lidar_16beam", "odometry", "uwb_labyrinth", "uwb_lias", "uwb_tiers")

ANY_FIXTURE: Any = {"deadline": None, "suppress_health_check": list(HealthCheck)}
settings.register_profile("dev", max_examples=15, **ANY_FIXTURE)
settings.register_profile("ci", max_examples=15, derandomize=True, print_blob=True, **ANY_FIXTURE)
settings.register_profile("nightly", max_examples=500, **ANY_FIXTURE)
settings.load_profile("ci" if os.environ.get("CI") else "dev")

# Whatever the terminal of the tests, commands print for one of 80 columns.
os.environ["COLUMNS"] = "80"

# nohup, and a shell that runs the tests in the background, have signals ignored, and what a test starts inherits that.
signal.signal(signal.SIGINT, signal.default_int_handler)
for number in (signal.SIGHUP, signal.SIGTERM):
    signal.signal(number, signal.SIG_DFL)


# Replays of this process; commands have their second process, as at a user's.
second_process.cores = lambda: 1


def pytest_sessionstart() -> None:
    """Fails where a part is missing that QUADLOG_REQUIRE names; without it the tests that need that part skip."""
    datasets = Path(os.environ.get("QUADLOG_DATASETS", "/nowhere"))
    missing = {
        "chromium": [] if CHROMIUM else ["chromium"],
        "datasets": [str(datasets / name) for name in DATASETS if not (datasets / name).is_dir()],
    }
    for part in filter(None, os.environ.get("QUADLOG_REQUIRE", "").split(",")):
        if part not in missing:
            raise pytest.UsageError(f"QUADLOG_REQUIRE: no part {part!r}; choose from {', '.join(missing)}")
        if missing[part]:
            raise pytest.UsageError(f"QUADLOG_REQUIRE={part}: not found: {', '.join(missing[part])}")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The tour of the pages, the longest, begins; what needs a cluster, object storage or the trolley is nightly."""
    items.sort(key=lambda item: item.path.name != "test_docs.py")
    for item in items:
        if {"make_cluster", "scheduler", "bucket", "trolley"} & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.nightly)


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], Any]], Any]:
    """What make(folder) gives, called once for all workers of pytest-xdist; the folder is not to be changed."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared"

    def made(name: str, make: Callable[[Path], Any]) -> Any:
        folder, given = shared / name, shared / f"{name}.pickle"
        folder.parent.mkdir(parents=True, exist_ok=True)
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not given.exists():
                shutil.rmtree(folder, ignore_errors=True)
                folder.mkdir()
                given.write_bytes(pickle.dumps(make(folder)))
        return pickle.loads(given.read_bytes())

    return made


def write_distribution(
    site: Path,
    name: str,
    version: str,
    entry_points: Mapping[str, Mapping[str, str]],
    modules: Mapping[str, str],
) -> Path:
    """A dist-info folder and modules in `site`, from which `importlib.metadata` and `import` find them."""
    info = site / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    lines = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in points.items())
        for group, points in entry_points.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))
    for module, text in modules.items():
        (site / f"{module}.py").write_text(text)
    return info


def forget_plugins() -> None:
    """What was found on the path until now."""
    plugins._installed.cache_clear()
    if "quadlog.pipelines.store" in sys.modules:
        sys.modules["quadlog.pipelines.store"].versions.cache_clear()  # type: ignore[attr-defined]
    if "quadlog.recordings.decoding" in sys.modules:
        sys.modules["quadlog.recordings.decoding"].plugged_decoder.cache_clear()  # type: ignore[attr-defined]


@pytest.fixture
def plugin_site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path, for this test, whose distributions are found; subprocesses find them too."""
    site = tmp_path / "site"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))
    monkeypatch.setenv("PYTHONPATH", str(site))
    forget_plugins()
    yield site
    forget_plugins()
    for name, module in list(sys.modules.items()):
        if (getattr(module, "__file__", None) or "").startswith(str(site)):
            del sys.modules[name]


@pytest.fixture
def install(plugin_site: Path) -> Installer:
    """Installs a distribution: (name, version, {group: {entry point: object}}, {module: source})."""

    def install(
        name: str,
        version: str = "1.0",
        entry_points: Mapping[str, Mapping[str, str]] = {},
        modules: Mapping[str, str] = {},
    ) -> Path:
        info = write_distribution(plugin_site, name, version, entry_points, modules)
        forget_plugins()
        return info

    return install


@pytest.fixture(scope="session")
def lias_site() -> SimpleNamespace:
    """uwb_lias, a real recording of three tags on a trolley: its folder, anchors (8, 3), the tags' places (3, 3)."""
    if "QUADLOG_DATASETS" not in os.environ:
        pytest.skip("QUADLOG_DATASETS is not set")
    folder = Path(os.environ["QUADLOG_DATASETS"]) / "uwb_lias"
    if not folder.exists():
        pytest.skip(f"{folder} is not there")
    anchors_m = [
        *((-3.4203, 3.0053, 1.0442), (0.0016, 3.0110, 1.0446), (3.6056, 2.9795, 1.0463), (3.6011, -0.0008, 1.0422)),
        *(
            (3.5674, -3.0087, 1.0443),
            (-0.0072, -2.9652, 1.0444),
            (-3.4673, -2.9587, 1.0445),
            (-3.4858, -0.0098, 1.0457),
        ),
    ]
    levers_m = [(-0.0689, -0.1423, 0.0011), (-0.0750, 0.1402, 0.0016), (0.2034, 0.1451, -0.0008)]
    return SimpleNamespace(folder=folder, anchors_m=np.array(anchors_m), levers_m=np.array(levers_m))


@pytest.fixture
def web(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[WebServer]:
    """The files of `web.folder` behind `web.url`, on loopback; what fails is tried again at once."""
    monkeypatch.setenv("NO_PROXY", "*")
    monkeypatch.setattr("quadlog.storage.remote_object.WAIT_S", 0.0)
    folder = tmp_path / "served"
    folder.mkdir()
    with serve(folder) as server:
        server.folder = folder
        yield server


@pytest.fixture(scope="session")
def object_storage() -> Iterator[str]:
    """The address of an S3-speaking server on loopback."""
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer("127.0.0.1", 0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def bucket(object_storage: str, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Any:
    """s3fs on an empty bucket, whose name is `bucket.name`."""
    import s3fs

    for name, value in (
        ("AWS_ENDPOINT_URL", object_storage),
        ("AWS_ACCESS_KEY_ID", "testing"),
        ("AWS_SECRET_ACCESS_KEY", "testing"),
        ("AWS_DEFAULT_REGION", "us-east-1"),
    ):
        monkeypatch.setenv(name, value)
    s3fs.S3FileSystem.clear_instance_cache()  # its key lacks the environment, so that another test's server would stay
    system = s3fs.S3FileSystem(use_listings_cache=False)
    system.name = f"lab-{abs(hash(request.node.nodeid)):x}"
    system.mkdir(system.name)
    return system


@pytest.fixture
def closed_port() -> int:
    """One that nobody listens at."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        port: int = taken.getsockname()[1]
    return port


@pytest.fixture(scope="session")
def walked() -> SynthesizedRecording:
    """Twelve seconds of a robot with a body on flat ground: 8 m and a bend."""
    from quadlog.simulation.synthetic import follow

    return follow.synthesize(seed=41, duration_s=12.0, azimuth_steps=120).with_body()
