"""What is fuzzed, one function per target; see TARGETS in table.py."""
