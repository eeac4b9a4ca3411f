"""The planners, one class for each name."""
