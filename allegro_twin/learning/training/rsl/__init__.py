"""Learners on tensors, wherever the simulations are, a GPU or processors: PPO of rsl-rl, and imitation."""
