"""Everything that makes a hand visible: cameras, films, strips, and what Rerun shows; colours and views are shared."""

import allegro_twin.sim as sim  # noqa: F401  # It chooses how MuJoCo renders, which must come before MuJoCo.
