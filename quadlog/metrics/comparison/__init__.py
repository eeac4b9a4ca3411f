"""Differences of metrics between planners, runs and seeds, with their intervals."""
