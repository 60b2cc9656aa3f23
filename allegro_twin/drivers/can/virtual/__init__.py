"""The hand's end of the bus: a virtual hand, what goes wrong with it, and adapters that do not exist to reach it by."""
