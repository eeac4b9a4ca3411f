"""The run folder: files, tables, maps, records."""
