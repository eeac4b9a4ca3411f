"""Positions of unknown UWB anchors from one recording: what the survey is given, what it says, and what it writes."""
