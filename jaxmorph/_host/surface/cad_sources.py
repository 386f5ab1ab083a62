"""CAD models by file or shape. It is alone so that OpenCASCADE is imported with a model alone."""

from pathlib import Path
from typing import Any

CAD_ENDINGS = (".step", ".stp", ".iges", ".igs", ".brep", ".brp")


def cad_model(source: Any) -> Any:
    """Makes the model, of a file or of a shape, whose surfaces are searched and evaluated."""
    from .cad import Model

    return Model.read(source) if isinstance(source, Path) else Model(source)
