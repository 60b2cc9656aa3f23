"""A depth camera in a simulated scene: what it sees, with what errors, when, and its faults."""

import allegro_twin.sim as sim  # noqa: F401  # It chooses how MuJoCo renders, which must come before MuJoCo.
