"""Synthesized recordings with known ground truth."""

SCENARIOS = {name: f"quadlog.simulation.synthetic.{name}" for name in ("follow", "forest", "corridor")}
"""Every scenario by name: the module that holds it, imported when it is wanted, with a function `synthesize`."""
