"""Excitations of a hand, and their recordings."""
