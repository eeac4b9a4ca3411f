"""A grid, a start and a goal become a path."""
