"""Import of other people's MJCF models of hands."""
