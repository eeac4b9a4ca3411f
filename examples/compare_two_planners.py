"""Replay a recording with two planners, print what differs and draw both walks over the map.

    python examples/compare_two_planners.py                          # the recording in fixtures/: half a minute
    python examples/compare_two_planners.py LOG.mcap quadlog.toml    # yours; quadlog init LOG.mcap writes the file

Runs go to runs/astar/ and runs/ia_star/, each with its report.html; the figure to planners.png.
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

import quadlog

FIXTURES = Path(__file__).parents[1] / "fixtures"
METRICS = ("success_rate", "expanded_mean", "suboptimality_mean", "eta_m", "clearance_min_m", "collisions")


def main(recording: Path, config: Path) -> None:
    """Replay with A* and IA*, and compare."""
    runs = {
        planner: quadlog.replay(
            recording,
            config=config,
            settings={"planner.name": planner},
            output=f"runs/{planner}",
            resume=True,
            plots=False,
        )
        for planner in ("astar", "ia_star")
    }
    print(f"{'metric':20}" + "".join(f"{planner:>12}" for planner in runs))
    for name in METRICS:
        values = [run.metric(name) for run in runs.values()]  # None if the recording lacks what the metric needs
        print(f"{name:20}" + "".join(f"{'-' if value is None else format(value, '.4g'):>12}" for value in values))

    _, axes = plt.subplots()
    maps = runs["astar"].maps
    if maps is not None:
        left_m, bottom_m = maps.origin_m[-1]
        occupied = maps.occupied(len(maps) - 1)  # (rows, columns), row = y
        height_m, width_m = (cells * maps.cell_m for cells in occupied.shape)
        extent = (left_m, left_m + width_m, bottom_m, bottom_m + height_m)
        axes.imshow(occupied, cmap="Greys", origin="lower", extent=extent, alpha=0.5)
    for planner, run in runs.items():
        walk = run.table("control")  # a pandas DataFrame; None if the replay ended before it
        if walk is not None:
            axes.plot(walk["x_m"], walk["y_m"], label=f"re-simulated with {planner}")
    poses = runs["astar"].table("poses")
    axes.plot(poses["x_m"], poses["y_m"], "k:", label="the logged robot")
    axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    axes.legend()
    plt.savefig("planners.png", dpi=150)


if __name__ == "__main__":
    given = [Path(word) for word in sys.argv[1:]]
    main(*given) if given else main(FIXTURES / "follow.mcap", FIXTURES / "follow.toml")
