"""Synthesized recordings with known ground truth."""
