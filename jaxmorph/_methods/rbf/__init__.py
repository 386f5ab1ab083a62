"""Radial basis functions: bases, systems, solvers, and the methods made of them."""
