"""The simulated quadruped (MuJoCo) and the unicycle."""
