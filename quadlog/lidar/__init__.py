"""Classify the points of lidar scans as outliers, ground or obstacles."""
