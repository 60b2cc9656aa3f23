"""A CAN bus and what is read from it and written to it: adapters, stamps, load."""
