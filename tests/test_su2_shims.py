"""A folder for `SU2_RUN`: what SU2's own scripts and FADO call, in the words in which they call it, with a stub for the flow solver."""

import os
import shlex
import shutil
import stat
import subprocess
import sys

import numpy as np
import pytest
from runs import printed, refused

from jaxmorph import cases, io
from jaxmorph.integrations import su2

PROGRAMS = ("SU2_DEF", "SU2_DOT", "SU2_DOT_AD")

CONFIG = """\
MATH_PROBLEM= {problem}
OBJECTIVE_FUNCTION= DRAG
MESH_FILENAME= {mesh}
MESH_OUT_FILENAME= mesh_deform.su2
MARKER_EULER= ( airfoil )
MARKER_FAR= ( farfield )
DV_KIND= HICKS_HENNE, HICKS_HENNE
DV_MARKER= ( airfoil )
DV_PARAM= ( 1.0, 0.3) ; ( 0.0, 0.6)
DV_VALUE_OLD= 0.0, 0.0
DV_VALUE_NEW= {values}
DV_VALUE= {values}
DEFORM_STIFFNESS_TYPE= INVERSE_VOLUME
GRAD_OBJFUNC_FILENAME= of_grad
RESTART_ADJ_FILENAME= restart_adj.dat
SOLUTION_ADJ_FILENAME= solution_adj.dat
"""
"""As SU2.io.Config.dump writes it: DV_VALUE is DV_VALUE_NEW, times the scales."""

SOLVER = """\
#!{python}
# a solver whose drag is the sum of exp(-r^2) over all nodes, r from (0.3, 0.2)
import sys
import numpy as np
options = dict(line.split("= ", 1) for line in open(sys.argv[1]).read().splitlines())
lines = open(options["MESH_FILENAME"]).read().splitlines()
first = next(k for k, line in enumerate(lines) if line.startswith("NPOIN"))
count = int(lines[first].split("=")[1].split()[0])
x = np.array([line.split()[:2] for line in lines[first + 1 : first + 1 + count]], float)
arm = x - [0.3, 0.2]
parts = np.exp(-np.sum(arm**2, axis=1))
if options["MATH_PROBLEM"] == "DIRECT":
    open("history.csv", "w").write(f'"ITER","CD"\\n0,{{float(parts.sum())!r}}\\n')
else:
    slopes = np.column_stack([x, -2 * arm * parts[:, None]]).tolist()
    rows = [",".join(map(repr, [k, *row])) for k, row in enumerate(slopes)]
    rows = ["PointID,x,y,Sensitivity_x,Sensitivity_y", *rows]
    name = options["RESTART_ADJ_FILENAME"].replace(".dat", "_cd.csv")
    open(name, "w").write("\\n".join(rows) + "\\n")
"""


def program(file, text):
    file.write_text(text)
    file.chmod(0o755)
    return file


@pytest.fixture
def programs(tmp_path):
    """SU2's folder: a solver, its own mover, which must not run, and the scripts' package."""
    folder = tmp_path / "bin of SU2"
    folder.mkdir()
    for name in ("SU2_CFD", "SU2_CFD_AD"):
        program(folder / name, SOLVER.format(python=sys.executable))
    for name in PROGRAMS:
        program(folder / name, "#!/bin/sh\nexit 7\n")
    (folder / "SU2").mkdir()
    (folder / "SU2" / "__init__.py").write_text("")
    return folder


@pytest.fixture
def shims(programs, tmp_path):
    folder = tmp_path / "su2 run"
    su2.write_shims(folder, programs=programs)
    return folder


def stand_in(shims, body):
    """Puts a program of the shell in place of the Python that the shims run."""
    fake = program(shims.parent / "python", f"#!/bin/sh\n{body}\n")
    for name in PROGRAMS:
        text = (shims / name).read_text()
        (shims / name).write_text(text.replace(sys.executable, str(fake)))


def call(shims, name, config="config_DEF.cfg", prefix="", cwd=None, **environment):
    """As SU2/run/interface.py does it: a shell's line, the errors in a pipe that is read at the end."""
    template = os.path.join(shlex.quote(str(shims)), "%s")
    command = prefix + template % f"{name} {config}"
    return subprocess.run(
        command, shell=True, capture_output=True, text=True, cwd=cwd, env=os.environ | environment
    )


def test_the_folder_has_three_programs_and_links_to_all_else(shims, programs, tmp_path):
    assert sorted(file.name for file in shims.iterdir()) == [
        *("SU2", "SU2_CFD", "SU2_CFD_AD", "SU2_DEF", "SU2_DOT", "SU2_DOT_AD"),
    ]
    assert (shims / "SU2_CFD").resolve() == programs / "SU2_CFD"
    assert (shims / "SU2").is_symlink()
    assert all((shims / name).stat().st_mode & stat.S_IXUSR for name in PROGRAMS)
    assert su2.write_shims(shims, programs=programs) == ("SU2_CFD", "SU2_CFD_AD")  # once more
    with pytest.raises(ValueError, match="SU2_DEF is a program of SU2: give a folder of its own"):
        su2.write_shims(programs)
    assert "exit 7" in (programs / "SU2_DEF").read_text()
    with pytest.raises(ValueError, match="is no folder"):
        su2.write_shims(tmp_path / "more", programs=tmp_path / "none")


def test_the_command_finds_the_programs(programs, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("SU2_RUN", raising=False)
    said = printed(capsys, ["su2", "shims", str(tmp_path / "a")])
    assert "none was found" in said
    assert f"export SU2_RUN={tmp_path / 'a'}" in said
    monkeypatch.setenv("SU2_RUN", str(programs))
    assert "SU2_CFD, SU2_CFD_AD" in printed(capsys, ["su2", "shims", str(tmp_path / "b")])
    monkeypatch.setenv("SU2_RUN", str(tmp_path / "b"))  # of an earlier call
    monkeypatch.setenv("PATH", str(programs))
    assert "SU2_CFD, SU2_CFD_AD" in printed(capsys, ["su2", "shims", str(tmp_path / "b")])
    assert (tmp_path / "b" / "SU2_CFD").resolve() == programs / "SU2_CFD"
    monkeypatch.setenv("PATH", str(tmp_path / "b"))
    assert "SU2_CFD, SU2_CFD_AD" in printed(capsys, ["su2", "shims", str(tmp_path / "b")])
    (tmp_path / "b" / "warnings.txt").touch()
    assert su2.write_shims(tmp_path / "d", programs=tmp_path / "b") == ("SU2_CFD", "SU2_CFD_AD")
    assert not (tmp_path / "d" / "warnings.txt").exists()
    refused(capsys, ["su2", "shims", str(programs)], "is a program of SU2")
    words = ["su2", "shims", str(tmp_path / "c"), "--method", "rbf"]
    refused(capsys, words, "su2 shims takes a folder alone")


def test_what_the_programs_run(shims):
    stand_in(shims, 'echo "$@"')
    for name, action in (("SU2_DEF", "def"), ("SU2_DOT", "dot"), ("SU2_DOT_AD", "dot")):
        done = call(shims, name)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout == f"-P -m jaxmorph su2 {action} config_DEF.cfg\n"


@pytest.mark.parametrize("name", ["OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID"])
def test_of_several_processes_the_first_works(shims, name):
    stand_in(shims, "echo works")
    others = dict.fromkeys(("OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "SLURM_PROCID"), "")
    assert call(shims, "SU2_DEF", **others | {name: "0"}).stdout == "works\n"
    assert call(shims, "SU2_DEF", **others | {name: "3"}).stdout == ""


def test_mpirun_starts_them(shims):
    if not (mpirun := shutil.which("mpirun")):
        pytest.skip("no mpirun")
    stand_in(shims, "echo works")
    allowed = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    allowed |= {"OMPI_MCA_rmaps_base_oversubscribe": "1"}
    done = call(shims, "SU2_DEF", prefix=f"{mpirun} -n 3 ", **allowed)
    assert (done.returncode, done.stdout) == (0, "works\n"), done.stderr


def test_status_2_is_not_a_flow_that_diverged(shims):
    for status, expected in ((0, 0), (1, 1), (2, 3)):
        stand_in(shims, f"echo wrong >&2; exit {status}")
        done = call(shims, "SU2_DEF")
        assert done.returncode == expected
        assert done.stderr == "wrong\n"
        (shims / "warnings.txt").unlink(missing_ok=True)


def test_warnings_are_said_once(shims, programs):
    stand_in(shims, "echo one >&2; echo two >&2")
    assert call(shims, "SU2_DEF").stderr == "one\ntwo\n"
    stand_in(shims, "echo one >&2; echo three >&2")
    assert call(shims, "SU2_DOT_AD").stderr == "three\n"
    assert call(shims, "SU2_DEF").stderr == ""
    su2.write_shims(shims, programs=programs)
    stand_in(shims, 'echo "jaxmorph su2: warning: $6: four" >&2')
    assert call(shims, "SU2_DEF", "a.cfg").stderr == "jaxmorph su2: warning: four\n"
    assert call(shims, "SU2_DOT", "b.cfg").stderr == ""
    su2.write_shims(shims, programs=programs)
    stand_in(shims, "echo one >&2; exit 1")
    assert call(shims, "SU2_DEF").stderr == "one\n"
    assert call(shims, "SU2_DEF").stderr == "one\n"  # what failed is always told


class Loop:
    """Does what SU2.eval does for a design: folders of their own, links to the mesh, dumped configs."""

    def __init__(self, folder, shims):
        self.folder, self.shims, self.count = folder, shims, 0
        io.write(folder / "mesh.su2", cases.naca0015(points=300))

    def run(self, name, program, problem, mesh, values):
        """Runs a program in a folder; returns the folder."""
        folder = self.folder / f"DSN_{self.count:03}" / name
        folder.mkdir(parents=True)
        (folder / mesh.name).symlink_to(os.path.relpath(mesh, folder))
        config = f"config_{program.removeprefix('SU2_')}.cfg"
        text = CONFIG.format(problem=problem, mesh=mesh.name, values=", ".join(map(repr, values)))
        (folder / config).write_text(text)
        self.call(program, config, folder)
        return folder

    def call(self, program, config, folder):
        done = call(self.shims, program, config, cwd=folder)
        assert done.returncode == 0, done.stderr
        self.errors = done.stderr

    def value(self, values):
        self.count += 1
        deformed = self.run("DEFORM", "SU2_DEF", "DIRECT", self.folder / "mesh.su2", values)
        self.mesh = deformed / "mesh_deform.su2"
        direct = self.run("DIRECT", "SU2_CFD", "DIRECT", self.mesh, values)
        return float((direct / "history.csv").read_text().splitlines()[1].split(",")[1])

    def gradient(self):
        """The adjoint, `restart2solution`, and the projection with a step of 1e-3, at the mesh of the last value."""
        step = [1e-3, 1e-3]
        folder = self.run("ADJOINT_DRAG", "SU2_CFD_AD", "DISCRETE_ADJOINT", self.mesh, step)
        (folder / "restart_adj_cd.csv").rename(folder / "solution_adj_cd.csv")
        (folder / "config_CFD_AD.cfg").rename(folder / "config_DOT_AD.cfg")
        self.call("SU2_DOT_AD", "config_DOT_AD.cfg", folder)
        return np.loadtxt(folder / "of_grad", skiprows=1)  # the name as it stands


@pytest.mark.slow
def test_a_loop_of_shape_optimization(shims, tmp_path):
    """The gradient that SU2's scripts read is the difference of the values that they read; warnings come once."""
    loop = Loop(tmp_path, shims)
    values = [1e-4, -2e-4]  # the projection is that of the deformed mesh, as SU2's is
    loop.value(values)
    assert loop.errors == ""  # of the solver, the last that ran
    said = (shims / "warnings.txt").read_text()
    assert "DEFORM_STIFFNESS_TYPE" in said
    gradient = loop.gradient()
    assert loop.errors == ""
    assert said == (shims / "warnings.txt").read_text()
    ends = [loop.value([values[0], values[1] + sign * 1e-3]) for sign in (1, -1)]
    np.testing.assert_allclose(gradient[1], (ends[0] - ends[1]) / 2e-3, rtol=1e-3)


@pytest.mark.slow
def test_a_run_of_fado(shims, tmp_path):
    """Programs of the path, files called as the adjoint solver left them: FADO links restart_adj_cd into the folder DOT."""
    loop = Loop(tmp_path, shims)
    adjoint = loop.run(
        "ADJOINT", "SU2_CFD_AD", "DISCRETE_ADJOINT", tmp_path / "mesh.su2", [0.0, 0.0]
    )
    dot = tmp_path / "DOT"
    dot.mkdir()
    for file in ("mesh.su2", "restart_adj_cd.csv"):
        (dot / file).symlink_to(adjoint / file)
    shutil.copy(adjoint / "config_CFD_AD.cfg", dot / "config_tmpl.cfg")
    environment = os.environ | {"PATH": f"{shims}{os.pathsep}{os.environ['PATH']}"}
    line = "SU2_DOT_AD config_tmpl.cfg"
    done = subprocess.run(
        line, shell=True, cwd=dot, env=environment, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    given = np.loadtxt(dot / "of_grad", skiprows=1)
    with pytest.warns(UserWarning, match="DEFORM_STIFFNESS_TYPE"):
        config = su2.read_config(dot / "config_tmpl.cfg")
    assert su2.read_sensitivity(config).path.name == "restart_adj_cd.csv"
    assert given.shape == (2,)
    assert np.abs(given).min() > 0
