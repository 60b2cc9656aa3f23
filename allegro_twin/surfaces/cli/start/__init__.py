"""Commands to start with: run, list, view, the panel, and moving a hand."""
