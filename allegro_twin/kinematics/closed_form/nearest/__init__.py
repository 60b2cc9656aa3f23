"""The posture whose fingertip comes nearest to a point, where none inside the joint limits reaches it."""
