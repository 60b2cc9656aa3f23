"""`Hand`, the facade for people at a prompt."""

from allegro_twin.surfaces.hand.facade import Hand

__all__ = ["Hand"]
