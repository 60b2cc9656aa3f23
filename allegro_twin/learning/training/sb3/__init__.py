"""PPO of Stable-Baselines3, on processors: the same policy again, to the bit."""
