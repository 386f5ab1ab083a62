"""Sparse matrices: factors, multigrid, orders, transposes."""
