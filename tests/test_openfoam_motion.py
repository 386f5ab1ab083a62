"""What patches do by a case's pointDisplacement, and `export`, which reads it."""

import contextlib
import json

import foam
import numpy as np
import pytest

from jaxmorph import io
from jaxmorph.cli import main

HEAD = (
    "FoamFile {{ version 2.0; format {form}; class pointVectorField; object pointDisplacement; }}\n"
)
FIELD = "dimensions [0 1 0 0 0 0 0]; internalField uniform ({inside}); boundaryField\n{{\n{entries}\n}}\n"
ZERO, MOVED = "uniform (0 0 0)", "uniform (0 0 1e-3)"


@pytest.fixture
def case(tmp_path):
    """A cube of eight bricks; its six sides are patches."""
    places = np.linspace(0, 1, 3)
    points = np.stack(np.meshgrid(places, places, places, indexing="ij"), axis=-1).reshape(-1, 3)
    ids = np.arange(27).reshape(3, 3, 3)
    square = ((0, 0), (1, 0), (1, 1), (0, 1))
    corners = [
        [ids[x + i, y + j, z + k] for k in (0, 1) for i, j in square]
        for x in (0, 1)
        for y in (0, 1)
        for z in (0, 1)
    ]
    sides = [
        (f"{'xyz'[axis]}{end}", "wall", lambda f, a=axis, e=end: bool((points[f, a] == e).all()))
        for axis in range(3)
        for end in (0, 1)
    ]
    return foam.write_case(tmp_path / "case", points, foam.hexahedra(corners), sides)


def roles(case, entries, inside="0 0 0", time="0", form="ascii"):
    """What `patch_roles` reads, after the field is written with these entries."""
    text = HEAD.format(form=form).encode() + FIELD.format(inside=inside, entries="ENTRIES").encode()
    body = entries if isinstance(entries, bytes) else entries.encode()
    path = case / time / "pointDisplacement"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(text.replace(b"ENTRIES", body))
    return io.patch_roles(io.read(case))


@pytest.mark.parametrize(
    ("entry", "role"),
    [
        (f"type fixedValue; value {ZERO};", "fixed"),
        ("type fixedValue; value uniform ( 0 -0.0 0e5 );", "fixed"),
        (f"type fixedValue; value {MOVED};", "moving"),
        ("type fixedValue; value $internalField;", "fixed"),
        ("type uniformFixedValue; uniformValue (0 0 0);", "fixed"),
        ("type uniformFixedValue; uniformValue constant (0 0 0);", "fixed"),
        ("type uniformFixedValue; uniformValue { type sine; } value uniform (0 0 0);", "moving"),
        ("type uniformFixedValue; uniformValue table ((0 (0 0 0)) (1 (0 0 1)));", "moving"),
        (f"type angularOscillatingDisplacement; omega 1; value {ZERO};", "moving"),
        (f"type sixDoFRigidBodyDisplacement; solver {{ type Newmark; }} value {ZERO};", "moving"),
        ("type codedFixedValue; code #{ if (a) { b; } #}; value uniform (0 0 0);", "moving"),
        ("type\n    slip; // fixedValue\n", "sliding"),
        ("type fixedNormalSlip; n (1 0 0);", "sliding"),
        ("type zeroGradient;", "free"),
        (f"type calculated; value {ZERO};", "free"),
        ("type cyclicAMI;", "fixed"),
        ("type symmetryPlane;", None),
        ("type $kind;", None),
        ("type fixedValue; value $moved;", None),
        ("type fixedValue;", None),
        ("$walls;", None),
        ("", None),
    ],
)
def test_a_type_says_what_a_patch_does(case, entry, role):
    others = '".*" { type zeroGradient; }'
    found = roles(case, f"x0 {{ {entry} }}\n{others}")
    assert found.pop("x0", None) == role
    assert found == dict.fromkeys(("x1", "y0", "y1", "z0", "z1"), "free")


def test_entries_are_found_as_openfoam_does(case):
    """The name first, then the last pattern that fits; directives are passed over."""
    text = f"""#includeEtc "caseDicts/setConstraintTypes"
    "(x0|x1)" {{ type slip; }}
    "x.*" {{ type fixedValue; value {MOVED}; }}
    x0 {{ type zeroGradient; }}
    "[" {{ type slip; }}
    "y." {{ type fixedValue; value {ZERO}; }}"""
    found = {"x0": "free", "x1": "moving", "y0": "fixed", "y1": "fixed"}
    assert roles(case, text) == found


def test_the_first_time_speaks_and_else_what_is_kept(case):
    assert io.patch_roles(io.read(case)) == {}
    assert roles(case, "x0 { type slip; }", time="0.orig") == {"x0": "sliding"}
    assert roles(case, "x0 { type zeroGradient; }", time="2") == {"x0": "free"}
    assert roles(case, f"x0 {{ type fixedValue; value {MOVED}; }}", time="0.5") == {"x0": "moving"}
    assert io.patch_roles(io.read(case / "constant" / "polyMesh")) == {"x0": "moving"}


def test_lists_of_values_are_no_words(case):
    """Text, and bytes among which are braces and semicolons."""
    rows = "\n".join(f"(0 0 {k})" for k in range(9))
    text = f"x0 {{ type fixedValue; value nonuniform List<vector> 9\n(\n{rows}\n);}} x1 {{ type slip; }}"
    assert roles(case, text) == {"x0": "moving", "x1": "sliding"}
    values = (b'};{("$#' * 36)[: 27 * 8]
    data = b"x0 { type fixedValue; value nonuniform List<vector> 9(" + values
    found = roles(case, data + b"); } x1 { type slip; }", form="binary")
    assert found == {"x0": "moving", "x1": "sliding"}


def test_damage_ends_in_no_fault(case):
    """What is cut anywhere is read as far as it goes, or refused by `ValueError`."""
    entries = "x0 { type fixedValue; value nonuniform List<vector> 2((0 0 1)(0 0 2)); }\n"
    entries += '"y." { type slip; }'
    assert len(roles(case, entries)) == 3
    path = case / "0" / "pointDisplacement"
    mesh = io.read(case)
    whole = path.read_bytes()
    for end in range(len(whole)):
        path.write_bytes(whole[:end])
        with contextlib.suppress(ValueError):
            assert set(io.patch_roles(mesh)) <= {"x0", "y0", "y1"}


def exported(case, capsys, *flags):
    """The exit status of `export`, and what it says."""
    status = main(["export", str(case), *flags])
    said = capsys.readouterr()
    return status, said.out + said.err


def test_export_reads_what_no_flag_names(case, capsys):
    push = f"x0 {{ type fixedValue; value {MOVED}; }}"
    roles(case, f'{push} x1 {{ type zeroGradient; }} ".*" {{ type fixedValue; value {ZERO}; }}')
    status, said = exported(case, capsys)
    assert status == 0
    assert "patches  fixed y0 y1 z0 z1; free x1; moving x0, by pointDisplacement" in said
    assert "older" not in said
    plan = (case / "constant" / "jaxmorph.plan").read_bytes()
    status, said = exported(
        case, capsys, "--moving", "x0", "--fixed", "y.", "z0", "z1", "--free", "x1"
    )
    assert status == 0
    assert "in place of an older file" in said
    assert "pointDisplacement" not in said
    assert (case / "constant" / "jaxmorph.plan").read_bytes() == plan
    status, said = exported(case, capsys, "--moving", "x1", "--json")
    facts = json.loads(said)
    assert status == 0
    assert facts["roles"] == dict.fromkeys(("y0", "y1", "z0", "z1"), "fixed") | {"x0": "moving"}
    assert facts["moving"] == 18


def test_export_asks_what_moves(case, capsys):
    """Where all are fixed or free something else moves a patch; without the file, as before."""
    status, said = exported(case, capsys)
    assert status == 2
    assert "--moving is missing" in said
    roles(case, f'".*" {{ type fixedValue; value {ZERO}; }}')
    status, said = exported(case, capsys)
    assert status == 2
    assert "preCICE" in said
    assert "no patch moves: fixed x0 x1 y0 y1 z0 z1. Give the wall a type" in said
    assert exported(case, capsys, "--moving", "x0")[0] == 0
