"""The commands that say what there is, and what works here."""
