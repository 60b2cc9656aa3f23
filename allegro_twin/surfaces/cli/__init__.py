"""The command line, allegro-twin. One folder for each panel of its --help."""
