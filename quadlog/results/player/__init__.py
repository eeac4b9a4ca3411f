"""The run as it went: what the page's player and the films show."""
