"""UWB ranges become fixes, fixes become a track."""
