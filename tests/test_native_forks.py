"""The motion solver against the headers of OpenFOAMs that are not installed here: by syntax, nothing is linked.

JAXMORPH_OPENFOAM_HEADERS is a folder of trees, or of archives TREE.tar.xz of them: TREE/flat/LIBRARY/*.H. A tree vNNNN is of
openfoam.com, any other one of openfoam.org. JAXMORPH_OPENFOAM_SOURCE is what native/openfoam/debian_headers.sh has filled.
"""

import os
import pathlib
import subprocess

import pytest

from jaxmorph import native

pytestmark = pytest.mark.nightly

HEADERS = os.environ.get("JAXMORPH_OPENFOAM_HEADERS")
SOURCE = os.environ.get("JAXMORPH_OPENFOAM_SOURCE")
LIBRARIES = ("OpenFOAM", "OSspecific/POSIX", "finiteVolume", "meshTools", "dynamicMesh")
SILENT = ("unused-parameter", "invalid-offsetof", "attributes", "unknown-pragmas")
"""Warnings of OpenFOAM's own headers, which its makefiles turn off too."""
FLAGS = (
    *("-fsyntax-only", "-Wall", "-Wextra", "-Wold-style-cast", "-Wnon-virtual-dtor", "-Werror"),
    *(f"-Wno-{name}" for name in SILENT),
    *("-ftemplate-depth-256", "-DWM_DP", "-DWM_LABEL_SIZE=32", "-DNoRepository"),
    *("-Dlinux64", "-DWM_ARCH_OPTION=64"),
)


def trees():
    """The names of the trees; none where no folder is given."""
    found = [] if HEADERS is None else pathlib.Path(HEADERS).iterdir()
    names = {path.name.removesuffix(".tar.xz") for path in found if path.suffix != ".md"}
    return sorted(names)


def compile_with(folders, standard, release=None):
    """Whether the motion solver compiles without an error or a warning; what was said."""
    version = [] if release is None else [f"-DOPENFOAM={release}"]
    source = native.folder / "openfoam"
    headers = [f"-I{folder}" for folder in (native.folder, source, *folders)]
    files = [str(source / f"{name}.C") for name in ("affineFields", "jaxmorphMotionSolver")]
    command = ["g++", f"-std={standard}", *FLAGS, *version, *headers, *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode == 0, done.stderr[-3000:]


@pytest.mark.parametrize("tree", trees())
def test_other_openfoams_compile_it(tmp_path, tree):
    place = pathlib.Path(HEADERS, tree)
    if not place.is_dir():
        subprocess.run(["tar", "-xJf", f"{place}.tar.xz", "-C", str(tmp_path)], check=True)
        place = tmp_path
    folders = sorted(place.glob("flat/*"))
    assert folders
    release = tree[1:] if tree.startswith("v") else None
    is_fine, said = compile_with(folders, "c++17", release)
    assert is_fine, said


@pytest.mark.skipif(SOURCE is None, reason="JAXMORPH_OPENFOAM_SOURCE is not set")
def test_debians_openfoam_compiles_it():
    folders = [pathlib.Path(SOURCE, "src", name, "lnInclude") for name in LIBRARIES]
    is_fine, said = compile_with(folders, "c++11", 1912)
    assert is_fine, said


@pytest.mark.skipif(HEADERS is None, reason="JAXMORPH_OPENFOAM_HEADERS is not set")
def test_a_fault_is_seen(tmp_path):
    """Without the headers nothing compiles: the tests above would fail."""
    assert not compile_with([tmp_path], "c++17")[0]
