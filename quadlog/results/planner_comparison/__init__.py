"""Tables, text and pictures of a planner comparison."""
