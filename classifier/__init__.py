"""From sums to the name of the touched object."""
