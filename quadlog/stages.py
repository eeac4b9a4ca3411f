"""The stages of a replay, in order, as `--until` takes them and reports show them."""

STAGES = ("ingest", "position", "filter", "map", "plan", "control", "report")


def stages_until(last: str) -> tuple[str, ...]:
    """The stages up to and including `last`."""
    return STAGES[: STAGES.index(last) + 1]
