"""What a hand really is: measured on it, and written into its own file."""
