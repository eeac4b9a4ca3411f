"""Where anchors stand: a survey by one walk, and a check of those that are configured."""
