"""`python -m allegro_twin` is `allegro-twin`."""

from allegro_twin.cli.main import main

main()
