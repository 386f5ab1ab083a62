"""Choices of sources: which nodes of a surface carry radial functions."""
