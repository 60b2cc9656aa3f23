"""From a hand's card to one MuJoCo model, and what can be asked of it."""
