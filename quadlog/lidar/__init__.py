"""A scan is split into outliers, ground and obstacles."""
