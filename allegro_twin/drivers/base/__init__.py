"""Base of the drivers: a serial line and the backend of a hand on it, keeper, faults, pace of virtual hands."""
