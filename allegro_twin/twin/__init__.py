"""The digital twin of one hand: identification, the mirror beside it, and what-if branches."""
