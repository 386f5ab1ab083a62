"""Bounds on det J of whole cells, by Bernstein coefficients."""
