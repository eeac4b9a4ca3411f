"""The command line: one file per command, which parses, calls one pipeline and prints."""
