"""A pre-registered study: does closing the hand while the arm still moves beat reach-then-grasp?"""
