"""The panel in the browser: two processes, one with the hand and one with the page, neither of which waits for the
other."""
