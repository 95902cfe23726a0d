"""A virtual CAN bus with arbitration, and batch access to any CAN interface."""
