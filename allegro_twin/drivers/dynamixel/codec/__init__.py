"""Packets of protocol 2.0, control tables, and what a count is worth. Pure."""
