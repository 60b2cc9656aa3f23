"""The commands about recordings and data sets."""
