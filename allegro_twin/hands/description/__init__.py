"""Descriptions of hands and arms: tables of facts, cards of other people's models, calibration, and how they look."""
