"""A Schunk hand on RS-485 whose frames nobody has published: our layout of them, the host's end and the hand's."""
