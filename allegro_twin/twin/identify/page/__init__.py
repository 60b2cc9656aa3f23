"""The report of an identification: one HTML file with nothing from anywhere else."""
