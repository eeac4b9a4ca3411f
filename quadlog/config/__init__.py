"""The configuration: its keys, and the TOML file."""
