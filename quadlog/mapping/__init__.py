"""Obstacle points become an occupancy grid around the robot."""
