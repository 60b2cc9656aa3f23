"""The postures that reach one point inside the joint limits, as a curve, and the best of them."""
