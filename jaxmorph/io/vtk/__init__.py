"""VTK's files."""
