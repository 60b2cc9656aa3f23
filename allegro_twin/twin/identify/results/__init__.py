"""What is known in the end: values and doubts, the gap that is left, and the hand's own file."""
