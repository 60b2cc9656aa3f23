"""The wire: what a hand of each version says on a CAN bus, the backend that listens, and a hand to put on a bus."""
