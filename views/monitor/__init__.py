"""A running skin in a terminal."""
