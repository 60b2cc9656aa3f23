"""What has no closed form, one target at a time: the best posture that reaches a point, and the nearest in reach."""
