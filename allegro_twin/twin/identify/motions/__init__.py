"""What a hand is made to do to be known, and the recordings of it."""
