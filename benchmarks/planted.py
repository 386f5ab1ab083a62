"""Faults planted at random in each room, and the fast tests that find them.

    python benchmarks/planted.py [--rooms _boundary io ...] [--each 3] [--seed 0]

Each fault changes one operator, comparison, number or sign within a function of a copy of the package, and runs the fast tests
of the room until the first fails. A fault that none finds is printed with its place: read it, since a third of all change nothing
that a user could see (a message, a guard that never acts, an order that does not matter).
"""

import argparse
import ast
import copy
import os
import pathlib
import random
import shutil
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).parents[1]
TESTS = {
    "_host": "adjacency cores corrections farthest gaps graded graph greedy ids lagrange prepare reduction wallfit",
    "_mesh": "exchange free_faces mesh vtk whole",
    "_methods": "bases cells contract corrections native rbf turn wallfit",
    "_boundary": "boundary periodic slide sliding_walls smooth_faces symmetry walls onto",
    "_plan": "halves plan prepare save steps",
    "_quality": "curved proof quality smooth_quality verdict wall_quality",
    "_improve": "curve improve",
    "_advice": "clashes compare crossings guard inspect largest_step turn",
    "shapes": "displacement offset onto shapes shapes_curves shapes_freeform shapes_measures variables",
    "io": "cgns decks fluent formats gmsh io kinds_of_files openfoam plot3d su2 vtk xdmf",
    "cli": "cli cli_gates cli_help cli_job cli_motion",
    "integrations": "idwarp openmdao su2_config su2_dot",
    "plot": "plot plot_sources",
}
"""The test files of each room."""

LEFT_OUT = shutil.ignore_patterns(".git", ".venv", "build", "site", "__pycache__")

OTHERS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.Lt: ast.GtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
"""What takes the place of an operator or a comparison."""


def spoil(node: ast.AST) -> str | None:
    """Changes a node in place; returns what it was, or None for one that has nothing to change."""
    before = ast.unparse(node) if isinstance(node, ast.expr) else ""
    match node:
        case ast.BinOp(op=op) | ast.BoolOp(op=op) if type(op) in OTHERS:
            node.op = OTHERS[type(op)]()
        case ast.Compare(ops=[op]) if type(op) in OTHERS:
            node.ops = [OTHERS[type(op)]()]
        case ast.UnaryOp(op=ast.USub(), operand=operand) if not isinstance(operand, ast.Constant):
            node.op = ast.UAdd()
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            node.value = value + 1
        case _:
            return None
    return before


def candidates(tree: ast.Module) -> list[int]:
    """Lists the places, in the order of `ast.walk`, that a fault may change: in functions, not in annotations or texts."""
    inside = set()
    for function in ast.walk(tree):
        if isinstance(function, ast.FunctionDef):
            for statement in function.body:
                inside.update(map(id, ast.walk(statement)))
    texts = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr | ast.Raise | ast.arguments | ast.AnnAssign)
        for part in ast.walk(node)
    }
    return [
        place
        for place, node in enumerate(ast.walk(tree))
        if id(node) in inside - texts and spoil(copy.deepcopy(node)) is not None
    ]


def plant(room: str, rng: random.Random, folder: pathlib.Path) -> str:
    """Plants one fault in a copy of the package; tells where, what was there, and what is there now."""
    files = sorted((folder / "jaxmorph" / room).rglob("*.py"))
    weights = [file.stat().st_size for file in files]
    while True:
        (file,) = rng.choices(files, weights)
        tree = ast.parse(file.read_text())
        places = candidates(tree)
        if places:
            break
    node = list(ast.walk(tree))[rng.choice(places)]
    before = spoil(node)
    file.write_text(ast.unparse(tree))
    now = ast.unparse(node)  # pyright: ignore[reportArgumentType]
    return f"{file.relative_to(folder)}:{getattr(node, 'lineno', 0)}: {before}  ->  {now}"


def is_found(room: str, folder: pathlib.Path) -> bool:
    """Runs the fast tests of a room on a copy."""
    files = [f"tests/test_{name}.py" for name in TESTS[room].split()]
    words = ["-m", "pytest", "-q", "-x", "-n", "2", "-p", "no:cacheprovider", *files]
    done = subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        timeout=900,
        check=False,
    )
    return done.returncode != 0


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rooms", nargs="+", choices=TESTS, default=list(TESTS))
    parser.add_argument("--each", type=int, default=3, help="faults of a room")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    found = 0
    for room in asked.rooms:
        if is_found(room, ROOT):
            raise SystemExit(f"the fast tests of {room} fail without a fault")
        rng = random.Random(f"{asked.seed} {room}")
        for _ in range(asked.each):
            with tempfile.TemporaryDirectory() as name:
                folder = pathlib.Path(name)
                shutil.copytree(ROOT, folder, ignore=LEFT_OUT, dirs_exist_ok=True)
                where = plant(room, rng, folder)
                caught = is_found(room, folder)
            found += caught
            print("found  " if caught else "missed ", where, flush=True)
    print(f"{found} of {len(asked.rooms) * asked.each} faults are found")


if __name__ == "__main__":
    main()
