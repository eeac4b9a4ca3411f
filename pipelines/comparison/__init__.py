"""Where the questions come from that planners are compared on, one module per kind of source."""
