"""Many simulations at once: on threads, and on a GPU."""
