"""Sweeps: many small pure computations on plain data, on this computer's cores or on a cluster."""
