"""From recordings to a drive: a regression, then output error, and how far that may be off."""
