"""Tables of the paper on incremental planning."""
