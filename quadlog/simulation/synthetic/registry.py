"""Every scenario by name: the module that holds it, imported when it is wanted, with a function `synthesize`."""

from __future__ import annotations

SCENARIOS = {
    "follow": "quadlog.simulation.synthetic.follow",
    "forest": "quadlog.simulation.synthetic.forest",
    "corridor": "quadlog.simulation.synthetic.corridor",
}
