"""The hub of a robot, and the keys of whoever connects to it."""
