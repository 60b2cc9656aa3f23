"""Results of an identification: values and uncertainties, the remaining gap, and the hand's own file."""
