"""Simulated lidar, UWB and IMU."""
