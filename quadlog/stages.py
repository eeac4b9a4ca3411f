"""The stages of a replay, in order, as `--until` takes them and reports show them."""

STAGES = ("ingest", "position", "filter", "map", "plan", "control", "report")
