"""What-if branches: a recording continues differently from some instant."""
