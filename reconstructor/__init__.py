"""From sums to the tactile image: bases, solvers and the service."""
