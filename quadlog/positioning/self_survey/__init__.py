"""Positions of UWB anchors that nobody surveyed, from ranges and the odometry of one walk."""
