"""Reads a file by gmsh in a process of its own: `_gmsh_apart.py FILE OUT.npz BYTES`.

gmsh holds one model in a process, and prints. The arrays are those of `_others.py`.
"""

import sys
from typing import Any

import gmsh
import numpy as np


def main(file: str, out: str) -> None:
    gmsh.initialize(argv=["gmsh", "-noenv"], readConfigFiles=False, interruptible=False)
    gmsh.option.setNumber("General.Terminal", 0)
    try:
        gmsh.open(file)
    except Exception as error:
        raise SystemExit(str(error)) from error
    values: dict[str, Any] = arrays()
    np.savez(out, **values)


def arrays() -> dict[str, np.ndarray]:
    """Points by their numbers, and the elements of each entity: type, ids of nodes, names."""
    found, places, _ = map(np.asarray, gmsh.model.mesh.getNodes())
    tags, result = np.sort(found), {"points": places.reshape(-1, 3)[np.argsort(found)]}
    for level, entity in gmsh.model.getEntities():
        groups = gmsh.model.getPhysicalGroupsForEntity(level, entity)
        names = [gmsh.model.getPhysicalName(level, group) or f"group_{group}" for group in groups]
        for number, _, nodes in zip(*gmsh.model.mesh.getElements(level, entity), strict=True):
            width = gmsh.model.mesh.getElementProperties(number)[3]
            key = f"{len(result)}"
            result[f"nodes {key} {number}"] = np.searchsorted(tags, nodes).reshape(-1, width)
            result[f"names {key}"] = np.array(names or [f"entity_{entity}"])
    return result


if __name__ == "__main__":
    main(*sys.argv[1:3])
