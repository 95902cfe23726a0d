"""Compiled solvers: FISTA for an SBHE with wavelets, total variation or contourlets, in place."""
