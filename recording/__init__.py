"""Recordings of a running skin: made, played again through the services, and turned into other files."""
