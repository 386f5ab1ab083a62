"""Moves inner nodes to where cells are least distorted."""
