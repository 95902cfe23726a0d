"""Sending steps: what a node does with its samples before anything is sent, and when it sends."""
