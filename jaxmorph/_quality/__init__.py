"""Measures of cells, relative to the undeformed mesh."""
