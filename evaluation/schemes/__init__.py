"""Ways of acquiring a touch over one bus, held against each other."""
