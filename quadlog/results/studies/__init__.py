"""What several runs say together: a sweep, a comparison of planners, the tables of the papers."""
