"""The state that is stepped, and the backend that drives it."""
