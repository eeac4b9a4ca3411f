"""Metrics, checks and references of saved runs."""
