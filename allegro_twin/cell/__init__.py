"""The lab's system: an arm that sees a thing, takes it and says whether it has it."""
