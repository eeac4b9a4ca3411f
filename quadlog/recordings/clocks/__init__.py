"""One rule for times: which clock, what is moved, what is left out."""
