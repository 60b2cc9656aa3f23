"""Contacts, distances and reachable postures of a hand in a scene."""
