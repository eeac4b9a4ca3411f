"""Tables of the paper on 3-D foot curves."""
