"""Fits a drive to recordings: a regression, then output error, and the uncertainty of both."""
