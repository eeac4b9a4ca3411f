"""Damaged and hostile inputs against everything quadlog reads: `make fuzz`."""
