"""Loops that XLA compiles badly (logarithm, narrow product), host calls, and safe derivatives."""
