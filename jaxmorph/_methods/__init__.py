"""Methods: each turns displacements of the surface into a displacement field."""
