"""Worlds in which planners are compared."""
