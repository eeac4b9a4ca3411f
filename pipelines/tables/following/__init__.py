"""Tables of the paper on following a person."""
