"""What marks a file as a recording."""

FORMAT = "allegro_twin.recording"
VERSION = 1
"""Of one device."""
SHARED = 2
"""Of several tracks, each of which has what a file of one device has."""
