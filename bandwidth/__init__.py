"""What fits on a bus: exact frame bits and the arithmetic built on them."""
