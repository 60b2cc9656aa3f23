"""Hands that answer when they are asked, whatever their bytes: what they have in common, at both ends of the line."""
