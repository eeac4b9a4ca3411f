"""Tables of real recordings with a truth, which no paper prints."""
