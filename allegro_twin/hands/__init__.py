"""Hands: who a hand is, how its models are generated, and what its library stores."""
