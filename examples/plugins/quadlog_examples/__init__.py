"""A planner and a message decoder that quadlog finds by their entry points."""
