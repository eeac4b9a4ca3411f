"""Yaw from IMU, odometry or course."""
