"""The page's process: viser behind the front door. It has no hand; it sends wishes and shows what it is told."""
