"""A path becomes velocity commands."""
