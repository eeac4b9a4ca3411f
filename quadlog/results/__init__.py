"""The run folder: written, read, drawn and exported."""
