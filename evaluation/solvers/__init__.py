"""Solvers and measurement operators of the paper's comparisons, which no running skin needs."""
