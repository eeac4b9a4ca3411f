"""Where work runs: in this process, in others on this machine, or on the workers of a cluster."""
