"""The web page of a skin."""
