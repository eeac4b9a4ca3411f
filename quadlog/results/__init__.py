"""The run folder: what is written, read back, drawn and exported."""
