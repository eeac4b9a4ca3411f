"""Numbers, tables and markup as text."""
