"""The commands that run a hand and look on."""
