"""One decoder per message family."""
