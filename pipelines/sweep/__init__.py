"""A grid of settings, one replay each, with the stages that settings share done once."""
