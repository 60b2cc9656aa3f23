"""Files: where they ship, how YAML becomes settings, and how nothing is ever half written."""
