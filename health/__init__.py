"""The health of a skin: what every view of it tells."""
