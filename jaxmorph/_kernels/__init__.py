"""Loops that XLA does not compile well by itself: a logarithm and a narrow matrix product; roots that are safe at zero."""
