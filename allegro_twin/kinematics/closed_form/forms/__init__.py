"""Closed forms: of a finger and of the thumb, each formula for a number and for an array alike."""
