"""Solids that could stand on the table, each fitted to the same points."""
