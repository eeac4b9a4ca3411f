"""Many recordings, one replay each."""
