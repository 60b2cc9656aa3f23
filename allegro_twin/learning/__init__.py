"""Learning: tasks, Gymnasium environments, policies and their training."""
