"""Filters and smoothers over fixes."""
