"""Measured against peers: `skin bench`."""
