"""Ratios in one run against a bare MuJoCo loop: `make bench`. Never a timed test, for machines are noisy."""
