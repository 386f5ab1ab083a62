"""Source for programs that move a mesh by an exported plan: C, C++, Fortran and OpenFOAM."""

from pathlib import Path

folder = Path(__file__).parent
"""Folder of `jmplan.h`, and of the motion solver for OpenFOAM."""
