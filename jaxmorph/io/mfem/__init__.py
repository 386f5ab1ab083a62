"""MFEM's files."""
