"""Positions of the robot and the target from each source: UWB, tf, odometry, lidar."""
