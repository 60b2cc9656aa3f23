"""A serial line and its ends: a port, a terminal that a virtual hand is reached by, a keeper, bytes that get spoilt."""
