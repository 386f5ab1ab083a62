"""Loops that XLA compiles badly (a logarithm, a narrow matrix product), calls of the host, and safe derivatives."""
