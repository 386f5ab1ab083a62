"""The driver: prepares a plan on the host, and moves points, blocks, steps and devices in traced code."""
