"""Tables of the paper on path tracking."""
