"""A four-legged robot, from a wanted velocity to joint torques."""
