"""Control: laws, trajectories and the controllers made of them."""
