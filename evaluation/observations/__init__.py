"""What the recognition of objects is measured on: signals of every observation, and splits of them."""
