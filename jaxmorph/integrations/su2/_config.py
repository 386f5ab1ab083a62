"""A config file and its mesh as a shape, its parameters, and the patches that move and stay."""

import dataclasses
import functools
import os
import pathlib
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxmorph import Mesh, io, shapes
from jaxmorph._host.package.arguments import checked
from jaxmorph._host.package.errors import warn

from ._airfoil import SIDED, airfoil_parts
from ._boxes import box_parts, boxes_of
from ._control import BoxPart
from ._motion import AbstractPart, DesignVariables, Displacement, rigid_parts
from ._options import Options, read_options
from ._planes import free_coordinates
from ._variables import CONSTANT, LEFT, NOTHING, WHOLE, Variable, checked_variables

LARGE = 0.5
"""Motion of a wall over its own length that is taken for a mistake."""


@dataclasses.dataclass(frozen=True, eq=False)
class Config:
    """A config file and its mesh: the shape that moves the wall, and the patches.

    - `mesh`: the mesh of `MESH_FILENAME`; `output` is the file of `MESH_OUT_FILENAME`.
    - `shape`, `parameters`: moves the nodes `mesh.patch(*moving)` by values (n,); at
      `shape.neutral()` nothing moves.
    - `moving`, `symmetry`, `fixed`: names of patches, `DV_MARKER`, `MARKER_SYM`, and all others but
      `MARKER_INTERNAL`. A design variable such as `SCALE_GRID` moves all of them.
    - `steps`: of `DEFORM_NONLINEAR_ITER`.
    - `boxes`: free-form boxes of the mesh, or of `FFD_DEFINITION` where `DV_KIND` is `FFD_SETTING`
      or the mesh has none.
    - `names`: of the design variables, as `shapes.names` has them for other shapes.
    - `options`: the options as text, by name.
    """

    mesh: Mesh
    output: pathlib.Path
    shape: DesignVariables
    parameters: Float[np.ndarray, " n"]
    moving: tuple[str, ...]
    symmetry: tuple[str, ...]
    fixed: tuple[str, ...]
    steps: int
    boxes: tuple[io.Box, ...]
    options: Options

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the design variables."""
        return self.shape.names

    @property
    def angles(self) -> list[int]:
        """Places of the angles of attack among the design variables: no wall moves by them."""
        return [k for k, name in enumerate(self.names) if name.partition("[")[0] in LEFT]

    @property
    def constants(self) -> list[str]:
        """Names of design variables that move the wall whatever their value is."""
        return [name for name in self.names if name.partition("[")[0] in CONSTANT]

    @functools.cached_property
    def path(self) -> Float[np.ndarray, "k m d"]:
        """Total displacements of the moving nodes in equal steps, as `jm.march` takes them."""
        x = np.asarray(self.mesh.points)[self.mesh.patch(*self.moving)]
        u = np.asarray(jax.jit(self.shape)(x, self.parameters)) - x
        return np.stack([u * (k + 1) / self.steps for k in range(self.steps)])

    @property
    def largest(self) -> float:
        """Largest displacement of a moving node."""
        return float(np.linalg.norm(self.path[-1], axis=1).max(initial=0))

    @property
    def share(self) -> float:
        """`largest` over the length of the moving patches: for an airfoil, in chords."""
        x = np.asarray(self.mesh.points)[self.mesh.patch(*self.moving)]
        length = np.ptp(x, axis=0).max() if len(x) else 0
        return float(self.largest / length) if length else 0.0

    @property
    def moved_boxes(self) -> tuple[io.Box, ...]:
        """The boxes with the control points where the parameters put them."""
        changes = {id(part.control): part for part in self.shape.parts if isinstance(part, BoxPart)}
        moved = {box.name: box for box in self.boxes}
        values = jnp.asarray(self.parameters) * self.shape.scales
        for part in changes.values():
            name = part.variables[0].box
            change = np.asarray(part.change(values[np.array(part.rows, int)]))
            moved[name] = dataclasses.replace(moved[name], control=moved[name].control + change)
        return tuple(moved.values())


@checked
def read_config(path: str | os.PathLike[str], *, definition: bool = False) -> Config:
    """Reads a config file of SU2, and the mesh that it names.

        config = su2.read_config("inv_NACA0012.cfg")
        plan = jm.prepare(config.mesh, config.moving, config.fixed, symmetry=config.symmetry)
        u = shapes.displacement(config.shape, plan, config.parameters)

    **Arguments:**

    - `path`: the config file; names of files in it are relative to its folder.
    - `definition`: True takes the design variables of `DEFINITION_DV`, with its scales, at the
      values of `DV_VALUE_NEW` (else all at rest). Default: the variables of `DV_KIND`.

    **Returns:** a `Config`.

    **Raises:** `ValueError` for kinds, words and numbers that are not taken, each with its option.

    **Warns:** of options that SU2 would honour, markers that the mesh lacks, surplus numbers of
    `DV_PARAM`, and of a wall that moves by more than half of its length.
    """
    options = read_options(pathlib.Path(path))
    listed, markers = checked_variables(options, definition)
    mesh = io.read(options.mesh_file)
    is_setting = any(variable.kind == "FFD_SETTING" for variable in listed)
    is_whole = any(variable.kind in WHOLE for variable in listed)
    needs_moving = is_setting or any(variable.kind not in (*NOTHING, *LEFT) for variable in listed)
    moving = tuple(mesh.patches) if is_whole else _present(options, mesh, "DV_MARKER", markers, needs_moving)
    planes, inner = (_present(options, mesh, name, options.words(name)) for name in ("MARKER_SYM", "MARKER_INTERNAL"))
    try:
        boxes = boxes_of(options, mesh, moving, is_setting)
        parts = _parts(options, listed, mesh, moving, boxes)
    except ValueError as error:
        raise ValueError(f"{options.path}: {str(error).removeprefix(f'{options.path}: ')}") from None
    shape = _shape(options, listed, parts, free_coordinates(mesh, moving, () if is_whole else planes))
    symmetry = tuple(name for name in planes if name not in moving)
    loose = {*moving, *symmetry, *inner}
    steps = options.whole("DEFORM_NONLINEAR_ITER", options.text("DEFORM_NONLINEAR_ITER", "1"))
    config = Config(
        mesh,
        options.output,
        shape,
        _values(options, shape, definition),
        moving,
        symmetry,
        tuple(name for name in mesh.patches if name not in loose),
        steps,
        boxes,
        options,
    )
    _warn_of_results(config, listed)
    return config


def _present(
    options: Options, mesh: Mesh, name: str, markers: Sequence[str], is_needed: bool = False
) -> tuple[str, ...]:
    """Lists the patches of the markers that the mesh has, and warns of the others."""
    present, absent = [], []
    for marker in markers:
        try:
            present += mesh.patch_names(marker)
        except ValueError:
            absent.append(marker)
    if is_needed and not present:
        raise options.error(
            name, f"names no marker of the mesh, so nothing would move; it has {', '.join(mesh.patches)}"
        )
    if absent:
        warn(f"{options.path}: {name}= the mesh has no marker {', '.join(absent)}; left out.")
    return tuple(dict.fromkeys(present))


def _warn_of_results(config: Config, listed: Sequence[Variable]) -> None:
    """Warns of what SU2 would do otherwise, and of a wall that moves suspiciously far."""
    options, kinds = config.options, [variable.kind for variable in listed]
    for kind in dict.fromkeys(kind for kind in kinds if kind in LEFT):
        warn(f"{kind} is left alone: it is the flow solver's, no wall moves by it.")
    if left_out := options.left_out():
        warn(f"{options.path}: not honoured here, though SU2's result depends on it: {', '.join(left_out)}.")
    relaxed, may_be_far = options.relaxation, {*CONSTANT, *WHOLE, *LEFT}
    if relaxed == 1:
        may_be_far |= {"TRANSLATION", "ROTATION", "SCALE"}
    if config.share > LARGE and not may_be_far.issuperset(kinds):
        cause = f"OPT_RELAX_FACTOR= {relaxed:g} multiplies DV_VALUE, as in SU2" if relaxed != 1 else "check DV_VALUE"
        warn(f"{options.path}: the wall moves by {config.share:.3g} times its own length: {cause}.")


def _values(options: Options, shape: DesignVariables, definition: bool) -> Float[np.ndarray, " n"]:
    """Reads the value of each design variable; without `DV_VALUE_NEW` of them all are at rest."""
    name, rest = "DV_VALUE_NEW" if definition else "DV_VALUE", np.asarray(shape.rest)
    values = options.numbers(name) if name in options else []
    if not len(rest) or (definition and len(values) != len(rest)):
        return rest
    if len(values) != len(rest):
        raise options.error(name, f"{len(rest)} values expected, one for each number, found {len(values)}")
    return np.array(values)


def _sizes(listed: Sequence[Variable]) -> tuple[list[Variable], np.ndarray]:
    """Lists the variables that have values, and the place of each one's first value."""
    own = [variable for variable in listed if variable.kind not in NOTHING]
    return own, np.cumsum([0, *(variable.size for variable in own)])[:-1].astype(int)


def _parts(
    options: Options, listed: Sequence[Variable], mesh: Mesh, moving: Sequence[str], boxes: Sequence[io.Box]
) -> list[AbstractPart]:
    listed, first = _sizes(listed)
    if not listed:
        return []
    nodes, points = mesh.patch(*moving), np.asarray(mesh.points, float)
    is_sided = any(variable.kind in SIDED for variable in listed)
    normals = shapes.wall_normals(mesh, *moving) if is_sided else np.zeros((len(nodes), points.shape[1]))
    parts = rigid_parts(listed, first, points.shape[1]) + airfoil_parts(listed, first, points[nodes], normals)
    if listed[0].kind == "SURFACE_FILE":
        file = options.text("DV_FILENAME", options.text("MOTION_FILENAME", "surface_positions.dat"))  # the older name
        u = io.read_displacement(options.beside(file), mesh, nodes)
        parts.append(Displacement((0,), jnp.asarray(u)))
    return parts + box_parts(options, listed, first, mesh, moving, boxes)


def _shape(
    options: Options, listed: Sequence[Variable], parts: Sequence[AbstractPart], free: np.ndarray
) -> DesignVariables:
    listed, _ = _sizes(listed)
    sizes = [variable.size for variable in listed]
    relaxed = options.relaxation
    # SU2 relaxes amplitudes, not the vectors of control points without a direction, nor camber
    scales = [
        variable.scale * (relaxed if variable.size == 1 and variable.kind != "HICKS_HENNE_CAMBER" else 1)
        for variable in listed
    ]
    rest = [
        1 / scale if variable.kind.startswith("SCALE") else 0.0 for variable, scale in zip(listed, scales, strict=True)
    ]
    names = [
        f"{variable.kind}[{k}]" + (f"[{part}]" if variable.size > 1 else "")
        for k, variable in enumerate(listed)
        for part in range(variable.size)
    ]
    factors, neutral = (jnp.asarray(np.repeat(values, sizes)) for values in (scales, rest))
    return DesignVariables(tuple(names), tuple(parts), factors, neutral, jnp.asarray(free))
