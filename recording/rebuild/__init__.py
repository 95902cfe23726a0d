"""The images of a whole recording or CAN log, in one file."""
