"""Compiled solvers: FISTA for sums of blocks, or of any matrix, in place."""
