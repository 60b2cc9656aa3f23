"""The commands about environments, and policies that learn in them."""
