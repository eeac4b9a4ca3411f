"""The world a log is re-simulated in."""
