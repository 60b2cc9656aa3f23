"""Learners on tensors, on a GPU or processors: PPO of rsl-rl, and DAgger."""
