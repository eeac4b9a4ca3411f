"""Tables and values as text."""
