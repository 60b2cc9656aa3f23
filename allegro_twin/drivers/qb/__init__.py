"""Hands of qbrobotics' electronics on RS-485: packets, the host's end and the hand's."""
