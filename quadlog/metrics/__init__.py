"""Saved results become numbers fit to publish."""
