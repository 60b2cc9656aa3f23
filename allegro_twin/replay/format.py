"""What marks a file as a recording."""

FORMAT = "allegro_twin.recording"
VERSION = 1
