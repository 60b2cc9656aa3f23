"""The commands for a hand that is open, and for its bus."""
