"""Simulations beside a hand or its recordings: to fit a drive, and to mirror one."""
