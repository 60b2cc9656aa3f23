"""The journal of a run: what observers, recordings and reports are told of it."""
