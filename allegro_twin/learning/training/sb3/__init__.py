"""PPO of Stable-Baselines3, on processors: reproducible to the bit."""
