"""Images of a whole recording or CAN log, made at once."""
