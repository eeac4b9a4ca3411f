"""Where work runs: in processes on this machine, or on the workers of a cluster."""
