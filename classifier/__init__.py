"""From sums to the name of the touching object."""
