"""What drivers share: a serial line and the backend of a hand on it, the keeper, faults, the pace of virtual hands."""
