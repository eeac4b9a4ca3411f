"""The table of what each stage reads, held against what replays really read: a wrong entry would be a wrong number."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel

from quadlog.config.file import load_config
from quadlog.config.schema import Config
from quadlog.config.section import Section
from quadlog.pipelines.executor.progress import Silent, StageClock
from quadlog.pipelines.request import ReplayRequest
from quadlog.pipelines.stages import ingest
from quadlog.pipelines.stages.scans import ScanSettings
from quadlog.pipelines.stages.stage import Stage, stages_for
from quadlog.results.find_runs import OWN_FILES
from quadlog.results.stages import STAGES
from quadlog.storage.atomic_write import files_written

# `ingest` looks up where the lidar sits and leaves it in the walk, for `filter`.
ONLY_HANDED_ON = {"ingest": ("lidar.mount",)}
CONFIGURATIONS = {
    "as it is": ["simulation.controller=kinematic"],
    "fpmw": ["pursuit.rate_hz=50.0", "simulation.disturbances.push_n=60.0"],
    "fpm, foot curve": ["simulation.controller=fpm", "simulation.swing=foot_curve", "grid.extent=run"],
    "no UWB": ["topics.position=odometry", "topics.target=ahead", "grid.memory=decay", "grid.dilation=body"],
    "fixed": ["topics.position=fixed", "topics.target=fixed", "lidar.level=false", "simulation.controller=none"],
    "causal, huber": ["uwb.smooth=false", "uwb.method=huber", "uwb.calibrate=false", "simulation.controller=none"],
    "tags": [
        "uwb.tags=[{id=0, role='robot', x_m=-0.07}, {id=1, role='person', height_m=1.3}]",
        "simulation.controller=none",
        "smoothing.enabled=false",
        "lidar.mount.z_m=0.5",
    ],
}


def prefixes(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[type[BaseModel], str]]:
    """Every section, and where it stands in the file."""
    yield model, prefix
    for key, field in model.model_fields.items():
        inner = next(iter(get_args(field.annotation)), field.annotation)
        if isinstance(inner, type) and issubclass(inner, BaseModel):
            yield from prefixes(inner, f"{prefix}{key}.")


PREFIX = dict(prefixes(Config))


class Spy:
    """The keys read from any section, by what was at work."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.reads: dict[str, set[str]] = defaultdict(set)
        self.at_work: str | None = None
        spy, get, dump = self, Section.__getattribute__, Section.model_dump

        def spied_get(self: Section, name: str) -> Any:
            fields = type.__getattribute__(type(self), "__pydantic_fields__")
            if spy.at_work is not None and name in fields and type(self) is not Config:
                spy.reads[spy.at_work].add(PREFIX[type(self)] + name)
            return get(self, name)

        def spied_dump(self: Section, *args: Any, **kwargs: Any) -> Any:
            if spy.at_work is not None and type(self) is not Config:
                spy.reads[spy.at_work].add(PREFIX[type(self)].removesuffix("."))
            return dump(self, *args, **kwargs)

        patch.setattr(Section, "__getattribute__", spied_get)
        patch.setattr(Section, "model_dump", spied_dump)

    @contextmanager
    def at(self, name: str) -> Iterator[None]:
        before, self.at_work = self.at_work, name
        try:
            yield
        finally:
            self.at_work = before


def reads_of(request: ReplayRequest) -> dict[str, set[str]]:
    """What each stage reads, `ingest` too; what it writes must be its own."""
    with pytest.MonkeyPatch.context() as patch:
        spy = Spy(patch)
        stages = stages_for(request.options.until)
        scans = next((stage.name for stage in stages if "filter" in stage.names), "")
        of_config = ScanSettings.of_config

        def spied_settings(config: Config, *, maps: bool) -> ScanSettings:
            # While the recording is read clouds are classified already, by the configuration of their stage.
            with spy.at(scans):
                return of_config(config, maps=maps)

        patch.setattr(ScanSettings, "of_config", spied_settings)
        spy.at_work = "ingest"
        clouds = "map" if scans == "map" else "filter" if scans else None
        clock = StageClock()
        with (
            ingest.open_log(request, clock, Silent()) as log,
            ingest.open_walk(log, request, clock, Silent(), None, clouds) as walk,
        ):
            for stage in stages:
                with spy.at(stage.name), files_written() as written:
                    stage.load()(walk)
                assert {path.name for path in written} <= {*stage.files, "config.toml"}
    return spy.reads


def is_told(key: str, told: tuple[str, ...]) -> bool:
    return any(key == name or key.startswith(f"{name}.") for name in told)


def untold(reads: dict[str, set[str]], stages: tuple[Stage, ...]) -> dict[str, set[str]]:
    """Keys that were read, but neither by the table of the stage nor by those of the stages before it."""
    told: tuple[str, ...] = ()
    found = {}
    for stage in stages:
        told += stage.reads
        found[stage.name] = {key for key in reads[stage.name] if not is_told(key, told)}
    at_once = (*stages[0].reads, *ONLY_HANDED_ON["ingest"])
    found["ingest"] = {key for key in reads["ingest"] if not is_told(key, at_once)}
    return {name: keys for name, keys in found.items() if keys}


def made(fixtures: Path, follow_request: Callable[..., ReplayRequest], run: Path, **asked: Any) -> ReplayRequest:
    sets, preset, until = asked.get("sets", []), asked.get("preset"), asked.get("until", "control")
    config = load_config(fixtures / "follow.toml", sets, {}, preset=preset)
    return replace(follow_request(run, duration_s=0.5, until=until), config=config)


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_nothing_is_read_that_the_table_does_not_tell(name, fixtures, follow_request, tmp_path):
    reads = reads_of(made(fixtures, follow_request, tmp_path / "run", sets=CONFIGURATIONS[name]))
    assert untold(reads, stages_for("control")) == {}
    assert {"topics.position", "uwb.anchors"} <= reads["ingest"] | reads["position"]  # the spy sees something
    assert "grid.cell_m" in reads["map"]


def test_the_papers_methods_and_filter_alone_read_no_more_either(fixtures, follow_request, tmp_path):
    alone = reads_of(made(fixtures, follow_request, tmp_path / "a", preset="paper", until="filter"))
    assert untold(alone, stages_for("filter")) == {}
    assert {"ground.inlier_share", "lidar.outlier_neighbours"} <= alone["filter"]
    mapped = reads_of(made(fixtures, follow_request, tmp_path / "b", preset="paper", until="plan"))
    assert untold(mapped, stages_for("plan")) == {}


def test_every_key_of_the_configuration_belongs_to_a_stage_or_is_known_to_decide_nothing_in_a_replay():
    leaves = {f"{prefix}{key}" for model, prefix in PREFIX.items() if prefix for key in model.model_fields}
    told = tuple(name for stage in stages_for("report") for name in stage.reads)
    assert {key for key in leaves if not is_told(key, told)} == set()
    for name in told:
        assert name in leaves | set(Config.model_fields), name


def test_every_file_of_a_run_belongs_to_one_stage_or_is_written_anew_each_time():
    stages = stages_for("report")
    files = [name for stage in stages for name in stage.files]
    assert len(files) == len(set(files))
    always = {"run.json", "config.toml", "stages.json", "metrics.json", "report.html", "derived.mcap"}
    always |= {"foxglove-layout.json", "body.parquet", "gait.parquet"}
    assert set(files) | always == OWN_FILES
    for last in STAGES:
        names = [name for stage in stages_for(last) for name in stage.names]
        assert names == [stage for stage in STAGES[: STAGES.index(last) + 1] if stage not in ("ingest", "report")]
