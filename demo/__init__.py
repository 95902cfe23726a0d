"""The whole chain from one command."""
