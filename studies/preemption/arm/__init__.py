"""The study with the lab's arm in the loop, on objects that nobody measured."""
