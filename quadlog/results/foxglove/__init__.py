"""derived.mcap and its layout."""
