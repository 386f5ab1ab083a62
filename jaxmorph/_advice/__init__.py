"""Advice before and around a motion: inspections, sources to choose, steps to take."""
