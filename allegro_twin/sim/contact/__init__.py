"""What touches what, how near, and where the hand could be."""
