"""`Hand`, the facade for people at a prompt."""

from allegro_twin.hand.facade import Hand

__all__ = ["Hand"]
