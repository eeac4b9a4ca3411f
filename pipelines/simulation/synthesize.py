"""`quadlog synthesize`: write a scenario as a recording, and the configuration that replays it."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from pathlib import Path

import tomli_w

from quadlog.config.robots import RobotConfig
from quadlog.config.schema import Anchor, Config, LidarConfig, Mount, Tag, Topics, UwbConfig
from quadlog.errors import CannotWrite, UnknownName, UsageError
from quadlog.pipelines.executor.progress import Progress
from quadlog.results.find_runs import refuse_existing
from quadlog.simulation.sensors.lidar import SimulatedScan
from quadlog.simulation.synthetic import SCENARIOS
from quadlog.simulation.synthetic import recording as synthetic
from quadlog.simulation.synthetic.legged_walk import LeggedWalk
from quadlog.simulation.synthetic.writer import write_recording
from quadlog.storage.atomic_write import whole_file, write_whole

CONFIG_HEADER = "# For the replay of this synthesized recording; the anchors' biases are left for it to estimate.\n\n"


def make_recording(
    scenario: str, seed: int, duration_s: float, azimuth_steps: int, body: bool = False
) -> synthetic.SynthesizedRecording:
    """A scenario by name, with its truth; nothing is computed or written yet. Raises UnknownName.

    body: the robot is moved by a simulated quadruped, whose joints are recorded too.
    """
    if scenario not in SCENARIOS:
        raise UnknownName("scenario", scenario, SCENARIOS)
    made: synthetic.SynthesizedRecording = importlib.import_module(SCENARIOS[scenario]).synthesize(
        seed=seed, duration_s=duration_s, azimuth_steps=azimuth_steps
    )
    return made.with_body() if body else made


def synthesize(
    recording: synthetic.SynthesizedRecording,
    output: Path,
    config_output: Path | None = None,
    force: bool = False,
    progress: Progress | None = None,
) -> dict[str, int]:
    """Write a recording, and where asked the config that replays it; both appear whole. Returns messages per topic.

    Raises UsageError, AlreadyExists and CannotWrite.
    """
    for path, others in ((output, []), *([(config_output, [output])] if config_output else [])):
        refuse_existing(path, force, others, recording=not others)
        if not path.parent.is_dir():
            raise CannotWrite(path, "its folder does not exist")
    if output.suffix.lower() != ".mcap":
        raise UsageError(f"{output}: recordings are written as .mcap")
    with whole_file(output) as part:
        counts = write_recording(part, _watched(recording, progress or Progress()))
    if config_output is not None:
        write_whole(config_output, recording_config(recording).encode())
    return counts


def recording_config(recording: synthetic.SynthesizedRecording) -> str:
    """The quadlog.toml of a recording: anchors, tags, the lidar's place, the topic of the truth, the walker's model."""
    anchors = [
        Anchor(id=index, x_m=x, y_m=y, z_m=z) for index, (x, y, z) in enumerate(recording.site.anchors_m.tolist())
    ]
    roles = {tag.id: "person" if tag.id == synthetic.PERSON_TAG else "robot" for tag in recording.tags}
    tags = [
        Tag(id=tag.id, role=roles[tag.id], height_m=tag.height_m, x_m=tag.x_m, y_m=tag.y_m) for tag in recording.tags
    ]
    x, y, z = recording.transform_lidar_to_base[:3, 3].tolist()
    walk = recording.site.robot
    config = Config(
        topics=Topics(reference=synthetic.ROBOT_TRUTH_TOPIC),
        uwb=UwbConfig(anchors=anchors, tags=tags),
        lidar=LidarConfig(mount=Mount(x_m=x, y_m=y, z_m=z)),
    )
    if isinstance(walk, LeggedWalk):
        config = config.model_copy(update={"robot": RobotConfig(model=walk.robot.name)})
    return CONFIG_HEADER + tomli_w.dumps(config.model_dump(exclude_unset=True))


def _watched(recording: synthetic.SynthesizedRecording, progress: Progress) -> Iterator[synthetic.SynthesizedMessage]:
    """The recording's messages, with a step of progress for each scan."""
    progress.begin("scans", int(recording.duration_s * 1e9) // recording.lidar.sweep_ns)
    for message in recording.messages():
        if isinstance(message.message, SimulatedScan):
            progress.advance((message.log_time_ns - synthetic.START_NS) * 1e-9)
        yield message
