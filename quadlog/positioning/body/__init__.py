"""Several tags on one rigid body: its place and its yaw."""
