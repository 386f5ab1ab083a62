"""OpenFOAM cases for tests, written here from lists of faces, in every form that OpenFOAM writes."""

import dataclasses
import gzip
import os
import pathlib
import shutil
import subprocess

import numpy as np
import pytest


@dataclasses.dataclass(frozen=True)
class Form:
    """How the files are written: widths in bits, byte order, text or binary, packed or not."""

    binary: bool = False
    label: int = 32
    scalar: int = 64
    order: str = "<"
    packed: bool = False
    separate: bool = False
    """Binary faces one by one, as older versions of OpenFOAM write them."""

    @property
    def header(self):
        arch = f'    arch "{"LSB" if self.order == "<" else "MSB"};label={self.label};scalar={self.scalar}";\n'
        return arch if self.binary else ""


FORMS = {
    "ascii": Form(),
    "ascii-gz": Form(packed=True),
    "binary": Form(binary=True),
    "binary-64-labels": Form(binary=True, label=64),
    "binary-separate-faces": Form(binary=True, separate=True),
    "binary-32-scalars": Form(binary=True, scalar=32),
    "binary-big-endian-gz": Form(binary=True, order=">", packed=True),
}

BANNER = "/*---*- C++ -*---*\\\n| (a (banner) { |\n\\*---*/\n"
RULE = "// * * * (12) * * //\n\n"


def polyhedral(cells):
    """Faces in OpenFOAM's order, owners, neighbours; `cells` are lists of faces, each seen from outside."""
    seen = {}
    for cell, faces in enumerate(cells):
        for face in faces:
            seen.setdefault(frozenset(face), []).append((cell, list(face)))
    inner = sorted(
        (sides for sides in seen.values() if len(sides) == 2), key=lambda s: (s[0][0], s[1][0])
    )
    outer = [sides for sides in seen.values() if len(sides) == 1]
    return [s[0][1] for s in inner], [s[0][0] for s in inner], [s[1][0] for s in inner], outer


def write_case(case, points, cells, patches, form=FORMS["ascii"]):
    """Writes a case and returns its path; of `patches`, (name, type, test of a face's nodes), the first that fits takes a face."""
    faces, owner, neighbour, outer = polyhedral(cells)
    entries = []
    for name, kind, fits in patches:
        mine = [sides for sides in outer if fits(sides[0][1])]
        outer = [sides for sides in outer if sides not in mine]
        entries.append((name, kind, len(mine), len(faces)))
        faces, owner = faces + [s[0][1] for s in mine], owner + [s[0][0] for s in mine]
    assert not outer
    folder = pathlib.Path(case, "constant", "polyMesh")
    folder.mkdir(parents=True)
    write_file(
        folder, "points", "vectorField", _list(np.asarray(points, float), form, "scalar"), form
    )
    write_file(folder, "owner", "labelList", _list(np.array(owner), form, "label"), form)
    write_file(
        folder, "neighbour", "labelList", _list(np.array(neighbour, int), form, "label"), form
    )
    if form.separate:
        body = b"".join(_list(np.array(face), form, "label") for face in faces)
        write_file(folder, "faces", "faceList", f"{len(faces)}\n(".encode() + body + b"\n)", form)
    elif form.binary:
        starts = np.cumsum([0, *map(len, faces)])
        body = _list(starts, form, "label") + b"\n" + _list(np.concatenate(faces), form, "label")
        write_file(folder, "faces", "faceCompactList", body, form)
    else:
        # lists of more than ten labels take a line for each, as in OpenFOAM
        rows = [f"{len(f)}({' '.join(map(str, f))})" if len(f) <= 10 else
                f"\n{len(f)}\n(\n" + "\n".join(map(str, f)) + "\n)\n" for f in faces]  # fmt: skip
        write_file(
            folder, "faces", "faceList", f"{len(faces)}\n(\n{chr(10).join(rows)}\n)".encode(), form
        )
    rows = "".join(
        f'    "{name}"\n    {{\n        type {kind}; // a comment {{\n        inGroups 1({kind});\n'
        f"        nFaces {count};\n        startFace {start};\n    }}\n"
        for name, kind, count, start in entries
    ).replace(" {\n        in", "\n        in")
    write_file(
        folder, "boundary", "polyBoundaryMesh", f"{len(entries)}\n(\n{rows})\n".encode(), Form()
    )
    _system(pathlib.Path(case))
    return case


def write_parts(case, points, cells, patches, owner, form=FORMS["ascii"]):
    """The folders processor* of a case: cell k is in part `owner[k]`; `patches` test nodes of the whole mesh."""
    inner = {frozenset(face) for face in polyhedral(cells)[0]}
    for part in sorted(set(owner)):
        mine = [cell for cell, k in zip(cells, owner, strict=True) if k == part]
        ids = np.unique(np.concatenate([np.concatenate(cell) for cell in mine]))
        place = {node: row for row, node in enumerate(ids.tolist())}
        local = [[[place[node] for node in face] for face in cell] for cell in mine]
        between = (
            "procBoundary",
            "processor",
            lambda nodes, ids=ids: frozenset(ids[nodes].tolist()) in inner,
        )
        tests = [
            (name, kind, lambda nodes, ids=ids, fits=fits: fits(ids[nodes]))
            for name, kind, fits in patches
        ]
        folder = pathlib.Path(case, f"processor{part}")
        write_case(folder, np.asarray(points)[ids], local, [between, *tests], form)
        body = _list(ids, form, "label")
        write_file(folder / "constant" / "polyMesh", "pointProcAddressing", "labelList", body, form)


def _list(values, form, what):
    count = f"\n{len(values)}\n(".encode()
    if form.binary:
        width = form.label if what == "label" else form.scalar
        kind = f"{form.order}{'i' if what == 'label' else 'f'}{width // 8}"
        return count + values.astype(kind).tobytes() + b")" if len(values) else b"\n0"
    rows = [
        f"({' '.join(map(repr, row))})" if isinstance(row, list) else str(row)
        for row in values.tolist()
    ]
    return count + ("\n" + "\n".join(rows) + "\n)").encode()


def write_file(folder, name, kind, body, form):
    header = f"format {'binary' if form.binary else 'ascii'};\n{form.header}    class {kind};\n    object {name};\n"
    text = (
        f"{BANNER}FoamFile\n{{\n    version 2.0;\n    {header}}}\n{RULE}".encode()
        + body
        + b"\n\n// **** //\n"
    )
    if form.packed:
        (folder / f"{name}.gz").write_bytes(gzip.compress(text, mtime=7))
    else:
        (folder / name).write_bytes(text)


def _system(case):
    head = "FoamFile {{ version 2.0; format ascii; class dictionary; object {}; }}\n"
    settings = "application x; startFrom latestTime; startTime 0; stopAt endTime; endTime 1; deltaT 1; writeInterval 1;\n"
    schemes = " ".join(f"{name} {{ default none; }}" for name in (
        "ddtSchemes", "gradSchemes", "divSchemes", "laplacianSchemes", "interpolationSchemes", "snGradSchemes"))  # fmt: skip
    (case / "system").mkdir()
    for name, text in (("controlDict", settings), ("fvSchemes", schemes), ("fvSolution", "")):
        (case / "system" / name).write_text(head.format(name) + text)


def tree(folder):
    """Every file below a folder with its content."""
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


SHARE = pathlib.Path(shutil.which("checkMesh") or "bin/none").parent.resolve().parent / "share"
EXAMPLES = SHARE / "doc" / "openfoam-examples" / "examples"
"""Where Debian puts OpenFOAM's tutorials."""

ENVIRONMENT = {"WM_PROJECT_DIR": str(SHARE / "openfoam")} | os.environ


def need_openfoam():
    """Skips a test where OpenFOAM is missing, and fails it where it should not be: with JAXMORPH_OPENFOAM=required."""
    if shutil.which("checkMesh") is None or not EXAMPLES.is_dir():
        message = "OpenFOAM is not installed (apt install openfoam openfoam-examples)"
        if os.environ.get("JAXMORPH_OPENFOAM") == "required":
            pytest.fail(message)
        pytest.skip(message)


def run(case, *command):
    """What one of OpenFOAM's programs prints."""
    done = subprocess.run(
        command, cwd=case, env=ENVIRONMENT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command}: {done.stdout[-1000:]}{done.stderr[-1000:]}"
    return done.stdout


PARALLEL = ("mpirun.openmpi", "--allow-run-as-root", "--oversubscribe", "-n")
"""How OpenFOAM's programs start in several processes."""


def verdict(case, *options, processes=1):
    """checkMesh's: the checks that fail, without their numbers, or that none does; of a decomposed case by its processes."""
    marks = ("Failed", "Mesh OK", "***")
    check = (
        ["checkMesh"] if processes == 1 else [*PARALLEL, str(processes), "checkMesh", "-parallel"]
    )
    said = [
        line.strip()
        for line in run(case, *check, *options).splitlines()
        if any(m in line for m in marks)
    ]
    assert said
    return [line.split(",")[0] for line in said]


def write_point_vectors(path, values, form=FORMS["ascii"]):
    """A field of vectors at points, as adjointOptimisationFoam writes its sensitivities."""
    rest = b"\n;\n\nboundaryField\n{\n    wall { type calculated; value nonuniform List<vector> 1((1 2 3)); }\n}\n"
    body = b"dimensions [0 0 0 0 0 0 0];\n\ninternalField   nonuniform List<vector> "
    body += _list(np.asarray(values, float), form, "scalar") + rest
    path.parent.mkdir(parents=True, exist_ok=True)
    write_file(path.parent, path.name, "pointVectorField", body, form)


HEXAHEDRON = ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
WEDGE = ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5))
PYRAMID = ((0, 3, 2, 1), (0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4))
TETRA = ((0, 1, 3), (1, 2, 3), (2, 0, 3), (0, 2, 1))


def cell(shape, *nodes):
    return [[nodes[i] for i in face] for face in shape]


def hexahedra(corners):
    """Faces of each of these hexahedra."""
    return [cell(HEXAHEDRON, *row) for row in np.asarray(corners).tolist()]


def mixed():
    """A cube with a wedge beside it, a pyramid and a tetrahedron on top."""
    cube = [[x, y, z] for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]
    points = np.array([*cube, [2, 0, 0], [2, 0, 1], [0.5, 0.5, 2], [0.5, 2, 1.5]], float)
    points += 0.05 * np.sin(np.arange(36)).reshape(12, 3)
    cells = [
        cell(HEXAHEDRON, 0, 1, 2, 3, 4, 5, 6, 7),
        cell(WEDGE, 1, 8, 2, 5, 9, 6),
        cell(PYRAMID, 4, 5, 6, 7, 10),
        cell(TETRA, 6, 11, 7, 10),
    ]
    return points, cells


PATCHES = [
    ("floor", "wall", lambda face: max(face) < 4),
    ("rest", "patch", lambda face: True),
    ("none", "patch", bool),
]


def split():
    """A cube, and four small ones against its side: the first has five faces more corners, or more faces, than a hexahedron."""
    points = [[x, y, z] for x in (0, 1, 2) for y in (0, 0.5, 1) for z in (0, 0.5, 1)]
    at = {tuple(p): i for i, p in enumerate(points)}

    def corners(x, y, z, s):
        square = ((0, 0), (1, 0), (1, 1), (0, 1))
        return [at[x + i, y + j * s, z + k * s] for k in (0, 1) for i, j in square]

    small = [cell(HEXAHEDRON, *corners(1, y, z, 0.5)) for y in (0, 0.5) for z in (0, 0.5)]
    shared = [
        list(reversed(face))
        for faces in small
        for face in faces
        if all(points[n][0] == 1 for n in face)
    ]
    large = [
        [at[0, 0, 0], at[0, 0, 1], at[0, 1, 1], at[0, 1, 0]],
        [at[0, 0, 0], at[1, 0, 0], at[1, 0, 0.5], at[1, 0, 1], at[0, 0, 1]],
        [at[0, 1, 0], at[0, 1, 1], at[1, 1, 1], at[1, 1, 0.5], at[1, 1, 0]],
        [at[0, 0, 0], at[0, 1, 0], at[1, 1, 0], at[1, 0.5, 0], at[1, 0, 0]],
        [at[0, 0, 1], at[1, 0, 1], at[1, 0.5, 1], at[1, 1, 1], at[0, 1, 1]],
    ]
    used = sorted({n for faces in (*small, [*large, *shared]) for face in faces for n in face})
    new = {n: i for i, n in enumerate(used)}
    cells = [[[new[n] for n in face] for face in faces] for faces in ([*large, *shared], *small)]
    return np.array(points)[used], cells


def strip(normal, around=14):
    """A flat ring of quads, one of them two triangles, one layer thick along an axis; nodes of both planes mixed up."""
    angle = 2 * np.pi * np.arange(around) / around
    plane = np.concatenate(
        [r * np.column_stack([np.cos(angle), np.sin(angle)]) for r in (1, 1.25, 1.5)]
    )
    n = len(plane)
    order = np.random.default_rng(0).permutation(2 * n)
    points = np.insert(np.tile(plane, (2, 1)), normal, np.repeat([0, 0.1], n), axis=1)
    shuffled = np.empty_like(points)
    shuffled[order] = points
    cells = []
    for i in range(2 * around):
        j = i + 1 - (i % around == around - 1) * around
        quad = [i, around + i, around + j, j]
        for base in [quad[:3], [quad[0], *quad[2:]]] if i == 3 else [quad]:
            sides = [[a, b, b + n, a + n] for a, b in zip(base, base[1:] + base[:1], strict=True)]
            cells.append([base[::-1], [k + n for k in base], *sides])
    cells = [[[int(order[k]) for k in face] for face in faces] for faces in cells]
    if normal == 1:
        cells = [[face[::-1] for face in faces] for faces in cells]
    patches = [
        ("sides", "empty", lambda face: np.ptp(shuffled[face, normal]) == 0),
        ("far", "patch", lambda face: np.linalg.norm(np.delete(shuffled[face[0]], normal)) > 1.4),
        ("hole", "wall", lambda face: True),
    ]
    return shuffled, cells, patches


ANGLE = np.radians(2.5)
PRISM = ((0, 1, 4, 3), (0, 3, 5, 2), (1, 2, 5, 4), (0, 2, 1), (3, 4, 5))


def around(x, r, side):
    return np.stack([x, r * np.cos(ANGLE), side * r * np.sin(ANGLE)], axis=-1)


def pipe_of(is_cut=False):
    """Cells of x from 0 to 2 and r from 0 to 1, two along and two across; those at the axis are prisms.

    A cut at r = 0.4 gives both sides nodes of their own, at the same places.
    """
    x, r = np.meshgrid([0.0, 1, 2], [0.0, 0.4, 1], indexing="ij")
    front, back = np.arange(9).reshape(3, 3), np.arange(9).reshape(3, 3)
    back[:, 1:] = 9 + np.arange(6).reshape(3, 2)
    points = np.concatenate(
        [around(x, r, 1).reshape(-1, 3), around(x[:, 1:], r[:, 1:], -1).reshape(-1, 3)]
    )
    cells = []
    for i in range(2):
        a, b = back[i], back[i + 1]
        c, d = front[i], front[i + 1]
        # seen along x: the triangle of the axis and both sides
        prism = [a[0], a[1], c[1], b[0], b[1], d[1]]
        cells.append([[int(prism[k]) for k in face] for face in PRISM])
        brick = [a[1], b[1], b[2], a[2], c[1], d[1], d[2], c[2]]
        cells.append([[int(brick[k]) for k in face] for face in HEXAHEDRON])
    sides = {"front": set(front.ravel()), "back": set(back.ravel())}
    if is_cut:
        shared = np.concatenate([front[:, 1], back[:, 1]])
        new = dict(zip(shared.tolist(), range(len(points), len(points) + 6), strict=True))
        points = np.concatenate([points, points[shared]])
        cells[1::2] = [[[new.get(k, k) for k in face] for face in cell] for cell in cells[1::2]]
        sides = {name: ids | {new[k] for k in ids & set(new)} for name, ids in sides.items()}
    patches = [
        (name, "wedge", lambda face, ids=ids: set(face) <= ids) for name, ids in sides.items()
    ]
    patches += [
        ("wall", "wall", lambda face: bool((np.hypot(*points[face][:, 1:].T) > 0.99).all()))
    ]
    patches += [("ends", "patch", lambda face: True)]
    return points, cells, patches, x, r
