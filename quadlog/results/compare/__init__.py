"""Differences between runs, and bounds on metrics."""
