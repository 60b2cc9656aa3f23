"""Rerun: hands and cells in 3-D with their signals, live and from recordings."""
