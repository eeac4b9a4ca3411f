"""The stages of a replay: each binds a recording or a saved result to the algorithms."""
