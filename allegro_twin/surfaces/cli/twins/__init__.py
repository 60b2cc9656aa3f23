"""The commands that make a model the twin of one hand."""
