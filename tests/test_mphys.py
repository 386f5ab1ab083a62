"""Builders of MPhys in a real problem: one shape moves the lattice of OpenAeroStruct and the wall of a volume mesh."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from meshes import blocks, lattice

import jaxmorph as jm
from jaxmorph import cases, shapes

om = pytest.importorskip("openmdao.api")
pytest.importorskip("mphys")
# MPhys's variables are distributed, also where there is one process
pytestmark = [pytest.mark.filterwarnings("ignore"), pytest.mark.usefixtures("here")]


def wing(x, p):
    """Twist that grows along the span y, about the quarter chord; and a bend upward."""
    x = jnp.asarray(x)
    turned = shapes.twist(
        x, p["twist"], [0.25, -0.1, 0.0], [0.0, 1.0, 0.0], 2.0
    )  # no node at its ends
    return turned + p["rise"] * (x[:, 1:2] ** 2) * jnp.array([[0.0, 0.0, 1.0]])


SHAPE = shapes.Function(wing, {"twist": 0.0, "rise": 0.0})


@pytest.fixture(scope="module")
def plan():
    axis = np.linspace(-2, 3, 6)
    points = lattice(axis, axis, axis)
    hull = np.flatnonzero((points == -2).any(axis=1) | (points == 3).any(axis=1))
    wall = np.flatnonzero(np.abs(points - 0.5).max(axis=1) < 1)  # a body of eight nodes
    return jm.prepare(points, wall, hull, method=jm.RBF.classic())


@pytest.mark.slow
def test_builders_pass_openmdaos_check(plan):
    from jaxmorph.integrations.mphys import ShapeBuilder, VolumeBuilder

    volume = VolumeBuilder(plan)
    assert (volume.get_number_of_nodes(), volume.get_ndof()) == (8, 3)
    problem = om.Problem(reports=False)
    model = problem.model
    model.add_subsystem("mesh", volume.get_mesh_coordinate_subsystem())
    model.add_subsystem(
        "geometry", ShapeBuilder(SHAPE).get_mesh_coordinate_subsystem(), promotes=["twist", "rise"]
    )
    model.add_subsystem("volume", volume.get_coupling_group_subsystem())
    model.connect("mesh.x_aero0_mesh", "geometry.x_aero0_geometry_input")
    model.connect("geometry.x_aero0_geometry_output", "volume.x_aero")
    problem.setup()
    problem.set_val("twist", 0.1)
    problem.set_val("rise", 0.02)
    problem.run_model()
    u = shapes.displacement(SHAPE, plan, {"twist": 0.1, "rise": 0.02})
    np.testing.assert_allclose(
        problem.get_val("volume.aero_vol_coords"), np.ravel(jm.deform(plan, u)), atol=1e-14
    )
    data = problem.check_partials(out_stream=None, method="fd", form="central", step=1e-5)
    for name in ("geometry", "volume"):
        for entry in data[name].values():
            np.testing.assert_allclose(entry["J_fwd"], entry["J_fd"], atol=1e-8)
            np.testing.assert_allclose(entry["J_rev"], entry["J_fd"], atol=1e-8)


def test_the_volumes_inverted_cells_raise_analysis_error(plan):
    from jaxmorph.integrations.mphys import VolumeBuilder

    mesh = jm.Mesh(plan.points, {"hexahedron": blocks(np.arange(216).reshape(6, 6, 6))})
    problem = om.Problem(reports=False)
    problem.model.add_subsystem("volume", VolumeBuilder(plan, mesh).get_coupling_group_subsystem())
    problem.setup()
    for lift in (0.2, 3.5):
        u = np.tile([0, 0, lift], (8, 1))
        problem.set_val("volume.x_aero", np.ravel(plan.moving_points + u))
        count = int(jm.quality(mesh, jm.deform(plan, u)).inverted)
        assert (count > 0) == (lift > 1)
        if count:
            with pytest.raises(om.AnalysisError, match=f"{count} of 125 cells are inverted"):
                problem.run_model()
        else:
            problem.run_model()


def set_up(called, options):
    problem = om.Problem(reports=False)
    problem.model.add_subsystem("a", called(**options))
    problem.setup()


def test_nonsense_is_refused_by_name(plan):
    """The table holds each class of both modules; options of OpenMDAO are judged by OpenMDAO, which names them."""
    from jaxmorph.integrations import mphys, openmdao

    bend = shapes.FreeForm([-3.0] * 3, 7 * np.eye(3), (2, 2, 2))
    made = {
        "shape": bend,
        "parameters": bend.neutral(),
        "plan": plan,
        "flat": False,
        "positions": False,
    }
    table = {
        openmdao.MeshDeformation: ("plan", "mesh", "raise_if_inverted", "flat", "units"),
        openmdao.ShapeDisplacement: ("shape", "plan", "parameters", "positions", "flat", "units"),
        mphys.ShapeBuilder: ("shape", "parameters"),
        mphys.VolumeBuilder: ("plan", "mesh", "raise_if_inverted"),
    }
    built = {mphys.Geometry, mphys.Volume}
    classes = [
        each
        for module in (openmdao, mphys)
        for each in vars(module).values()
        if isinstance(each, type)
    ]
    own = [each for each in classes if each.__module__.startswith("jaxmorph.integrations.")]
    hidden = ("_", "Traced", "MovedMesh", "Deformed")
    assert {each for each in own if not each.__name__.startswith(hidden)} - built == set(table)
    for called, names in table.items():
        good = {name: made[name] for name in names if name in made}
        for name in names:
            for nonsense in (3j, "nonsense", object(), jm.Plan):
                with pytest.raises(
                    (ValueError, TypeError), match=f"`{name}`|[Oo]ption '{name}'|The {name} '"
                ):
                    set_up(called, good | {name: nonsense})
    flat = jm.prepare(np.eye(3, 2), [0], [1], method=jm.InverseDistance())
    with pytest.raises(ValueError, match="this mesh is in 2-D"):
        mphys.VolumeBuilder(flat)


@pytest.mark.nightly
def test_one_shape_moves_openaerostructs_lattice_and_a_volume_mesh():
    """Lift and drag of the lattice, and the volume's points, both by the same design variables, with total derivatives."""
    meshing = pytest.importorskip("openaerostruct.meshing.mesh_generator")
    pytest.importorskip("mpi4py")  # OpenAeroStruct's builder asks for its communicator
    from mphys.core import Multipoint
    from mphys.scenarios import ScenarioAerodynamic
    from openaerostruct.mphys import AeroBuilder

    from jaxmorph.integrations.mphys import ShapeBuilder, VolumeBuilder

    lattice = {
        "num_x": 3,
        "num_y": 7,
        "wing_type": "rect",
        "symmetry": True,
        "span": 4.0,
        "root_chord": 1.0,
    }
    lattice_points = meshing.generate_mesh(lattice)
    lattice_points[:, :, 1] *= -1  # OpenAeroStruct's half wing has y < 0; the shapes' span is |y|
    surface = {
        "name": "wing", "type": "aero", "symmetry": True, "S_ref_type": "wetted", "mesh": lattice_points * [1, -1, 1],
        "CL0": 0.0, "CD0": 0.0, "with_viscous": False, "with_wave": False, "k_lam": 0.05, "c_max_t": 0.3,
        "t_over_c": np.full(6, 0.1),
    }  # fmt: skip

    def either_side(x, p):
        mirror = jnp.array([[1.0, -1.0, 1.0]])
        return wing(x * mirror, p) * mirror

    shape = shapes.Function(either_side, {"twist": 0.0, "rise": 0.0})
    mesh = cases.wing(points=300, stations=4)
    points = np.asarray(mesh.points) * [1, -1, 1]
    volume_plan = jm.prepare(
        points, mesh.patch("wing"), mesh.patch("farfield"), method=jm.RBF.classic()
    )
    weights = np.random.default_rng(0).normal(size=points.size)

    class Top(Multipoint):
        def setup(self):
            aero, volume = (
                AeroBuilder([surface], options={"write_solution": False}),
                VolumeBuilder(volume_plan),
            )
            geometry = ShapeBuilder(shape)
            for name, builder in (("aero", aero), ("volume", volume)):
                builder.initialize(self.comm)
                self.add_subsystem(f"{name}_mesh", builder.get_mesh_coordinate_subsystem())
                part = geometry.get_mesh_coordinate_subsystem()
                self.add_subsystem(f"{name}_shape", part, promotes_inputs=["twist", "rise"])
                self.mphys_add_scenario(name, ScenarioAerodynamic(aero_builder=builder))
                self.connect(f"{name}_mesh.x_aero0_mesh", f"{name}_shape.x_aero0_geometry_input")
                self.connect(f"{name}_shape.x_aero0_geometry_output", f"{name}.x_aero")
            for name, value, units in (
                ("rho", 1.2, "kg/m**3"),
                ("v", 100.0, "m/s"),
                ("mach_number", 0.3, None),
            ):
                self.aero.set_input_defaults(name, value, units=units)
            weighted = om.ExecComp(
                "J = sum(w * x)", w={"val": weights}, x={"shape": weights.shape, "units": "m"}
            )
            self.add_subsystem("weighted", weighted)
            self.connect("volume.aero_vol_coords", "weighted.x")

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # those of the solvers
        problem = om.Problem(Top(), reports=False)
        problem.setup(mode="rev")
        problem.set_val("aero.angle_of_attack", 3.0, units="deg")
        problem.set_val("twist", 0.03)
        problem.set_val("rise", 0.01)
        problem.run_model()
        totals = problem.compute_totals(["weighted.J"], ["twist", "rise"])
        u = shapes.displacement(shape, volume_plan, {"twist": 0.03, "rise": 0.01})
        moved = np.ravel(jm.deform(volume_plan, u))
        np.testing.assert_allclose(problem.get_val("volume.aero_vol_coords"), moved, atol=1e-12)
        assert np.abs(problem.get_val("aero.f_aero")).max() > 0

        def value(p):
            return jnp.vdot(
                weights, jm.deform(volume_plan, shapes.displacement(shape, volume_plan, p))
            )

        slope = jax.grad(value)({"twist": 0.03, "rise": 0.01})
        for name in ("twist", "rise"):
            np.testing.assert_allclose(totals["weighted.J", name].item(), slope[name], rtol=1e-9)
