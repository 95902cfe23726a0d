"""What fits on a bus, and what is on it: response times, plans and logs."""
