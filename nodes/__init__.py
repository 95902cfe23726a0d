"""The robot's side: taxel electronics and one CANopen node per block."""
