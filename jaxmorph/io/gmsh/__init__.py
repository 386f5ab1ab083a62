"""gmsh's files: their sections, what they hold, and the files themselves."""
