"""Boards that send steps: what they do with their samples, and when they send what."""
