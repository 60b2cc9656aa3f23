"""Scenarios: described, planned, run and judged."""
