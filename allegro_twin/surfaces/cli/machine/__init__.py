"""The command that checks this computer."""
