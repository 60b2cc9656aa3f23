"""Commands that fit a model to one hand and compare the two."""
