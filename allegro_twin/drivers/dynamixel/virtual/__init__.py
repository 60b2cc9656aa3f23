"""Servos that do not exist, the bus that they hang on, and the hand behind them."""
