"""Small errors that are put into the package: which there are, which test reaches them, and who judges them fast."""
