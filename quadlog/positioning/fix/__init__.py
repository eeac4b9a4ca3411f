"""One position from the ranges of one epoch."""
