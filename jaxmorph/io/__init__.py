"""Meshes from files and into files: everything but the coordinates as it was."""

from ._displacement import read_displacement as read_displacement
from ._lattice import write_lattice as write_lattice
from ._registry import check_output as check_output
from ._registry import read as read
from ._registry import write as write
from ._sensitivity import read_sensitivity as read_sensitivity
from ._surface import read_surface as read_surface
