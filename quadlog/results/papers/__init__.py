"""The pages of the papers' tables."""
