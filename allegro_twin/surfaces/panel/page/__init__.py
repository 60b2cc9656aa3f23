"""The page of the panel: viser behind the panel's server. It has no hand; it sends requests and shows frames."""
