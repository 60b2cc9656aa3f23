"""What-if branches: a recording continues differently from some instant.

`what_if` is the entry. A simulation runs again from its beginning (`resimulate`). A hand on a wire is replaced by its
model, from what a mirror knows at that instant (`from_estimate`).
"""
