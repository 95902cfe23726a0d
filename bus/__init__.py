"""The wire itself: an arbitrated virtual CAN bus and batch access to any CAN interface."""
