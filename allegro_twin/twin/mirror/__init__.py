"""A model beside the hand: what it expects, what pushes the hand, and when that is a touch."""
