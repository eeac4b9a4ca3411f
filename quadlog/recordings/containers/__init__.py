"""Readers of MCAP, ROS 1 bags and ROS 2 databases: raw messages, losses and indexes."""
