"""Remote control of a cell: who may move its target and its fingers, and within which limits."""
