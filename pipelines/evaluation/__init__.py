"""Metrics, checks, references and pages of saved runs."""
