"""Recordings of hands and cells: write, read, replay and convert them."""
