"""Motion of arm and fingers: which paths, past what, and where a close on nothing ends."""
