"""The driver: prepares a plan on the host; moves points, blocks, steps and devices traced."""
