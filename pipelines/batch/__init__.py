"""Many replays: of many recordings, or of one with many settings."""
