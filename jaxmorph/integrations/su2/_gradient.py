"""The derivatives by the design variables as SU2_DOT writes them."""

import os

import numpy as np
from jaxtyping import Float

from jaxmorph._host.package.arguments import checked, finite_array
from jaxmorph._host.package.files import complete, output_path


@checked
def write_gradient(path: str | os.PathLike[str], gradient: Float[np.ndarray, " n"], objective: str = "DRAG") -> None:
    """Writes a derivative a line below a line with the name of the objective: `of_grad.dat`.

    **Arguments:**

    - `path`: the file.
    - `gradient`: (n,), in the order of the design variables.
    - `objective`: its name, as `OBJECTIVE_FUNCTION` has it.

    **Raises:** `ValueError` for values that are not finite, and a folder that is not there.
    """
    values = finite_array("gradient", gradient, (None,))
    lines = [f"{objective} gradient ", *map(repr, values.astype(float).tolist()), ""]
    with complete(output_path(path)) as partial:
        partial.write_text("\n".join(lines), encoding="utf-8")
