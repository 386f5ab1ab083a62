"""Derivatives of every measure on every type of cell, by every component of the corners: sound, inverted, flat and collapsed."""

import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from meshes import pair
from oracles import jacobian
from runs import over

import jaxmorph as jm
from jaxmorph._kernels.compile import UNTUNED
from jaxmorph._kernels.values import largest, smallest
from jaxmorph._quality.distortion import IDEAL
from jaxmorph._quality.report import MEASURES

SOLIDS = tuple(IDEAL)
SURFACES = ("triangle in 3-D", "quad in 3-D", "line")
EXTREMES = (
    *(
        "mean_skewness",
        "mean_aspect_ratio",
        "mean_non_orthogonality",
        "max_skewness",
        "max_aspect_ratio",
    ),
    *(
        "max_non_orthogonality",
        "min_volume",
        "min_jacobian",
        "min_volume_ratio",
        "min_jacobian_ratio",
    ),
)
CHEAP = ("triangle", "quad", "line")
"""Those that compile in seconds, for which forward mode, and the measures of a mesh alone, are tried too."""
QUICK = UNTUNED | {"xla_cpu_use_fusion_emitters": False}
"""Each program runs a few times."""
SMOOTH = ("skewness", "aspect_ratio", "non_orthogonality", "jacobian_ratio")


def neighbours(name):
    """Two cells that share a side, and the axis across it; the second is numbered the other way round."""
    if name == "line":
        return jm.Mesh(np.array([[0.0, 0], [1, 0], [0.2, -1]]), {"line": [[0, 1], [2, 0]]}), 1
    mesh = pair(name.removesuffix(" in 3-D"))
    axis = mesh.points.shape[1] - 1
    if name in SOLIDS:
        return mesh, axis
    return jm.Mesh(np.column_stack([mesh.points, 0.1 * mesh.points[:, 0] ** 2]), mesh.cells), axis


def states(mesh, axis):
    """Corners where the measures have derivatives, and corners where some have none."""
    rng = np.random.default_rng(1)
    points = np.array(mesh.points)
    noise, upper = 0.07 * rng.normal(size=points.shape), points[:, axis] > 0
    sound = points + noise
    inverted, flat, merged, needle = points.copy(), sound.copy(), sound.copy(), sound.copy()
    inverted[upper, axis] *= -0.4
    flat[:, axis], merged[1] = 0, sound[0]
    needle[:, 0] *= 1e-7
    folded = points.copy()
    folded[:, axis] = np.abs(points[:, axis])
    smooth = {"sound": sound, "inverted": inverted + noise}
    rough = {
        "ideal": points,
        "flat": flat,
        "merged": merged,
        "folded": folded,
        "one place": 0 * points,
    }
    return smooth, rough | {"needle": needle, "small": 1e-9 * sound}


def by_quality(mesh, points, alone):
    """Every number of a report relative to the undeformed mesh, and of the mesh alone."""
    reports = {"relative": jm.quality(mesh, points)} | (
        {"alone": jm.quality(mesh.moved(points))} if alone else {}
    )
    names = (*MEASURES, *EXTREMES, "centroid")
    return {
        f"{name}, {key}": getattr(report, name) for key, report in reports.items() for name in names
    }


def by_smooth_measures(mesh, points, solid):
    found = jm.smooth_quality(mesh, points, softness=1e-2)
    values = {f"{name}, smooth": getattr(found, name) for name in SMOOTH}
    return values | ({"distortion": jm.distortion(mesh, points, softness=1e-2)} if solid else {})


@over("name", slow=["line"], nightly=[name for name in (*SOLIDS, *SURFACES) if name != "line"])
def test_component_by_component(name):
    """Forward, reverse and differences agree on sound and inverted cells; all are finite where there is no derivative."""
    mesh, axis = neighbours(name)
    quickly = functools.partial(jax.jit, compiler_options=QUICK)

    def measures(points):
        return by_quality(mesh, points, name in CHEAP) | by_smooth_measures(
            mesh, points, name in SOLIDS
        )

    measured = quickly(measures)
    ways = [
        quickly(jax.jacrev(measures)),
        *([quickly(jax.jacfwd(measures))] if name in CHEAP else []),
    ]
    sound, rough = states(mesh, axis)
    compared = sound | {"ideal": rough["ideal"]}  # smooth measures have derivatives there
    for state, points in compared.items():
        jacobians = [way(points) for way in ways]
        for key, expected in jacobian(measured, points, 2e-4).items():
            if state == "ideal" and not key.endswith("smooth"):
                continue
            scale = max(1.0, np.abs(expected).max())
            for found in jacobians:
                np.testing.assert_allclose(
                    found[key], expected, rtol=0, atol=1e-8 * scale, err_msg=f"{key}, {state}"
                )
    for (state, points), dtype in itertools.product(rough.items(), (np.float64, np.float32)):
        values, jacobians = (
            measured(points.astype(dtype)),
            [way(points.astype(dtype)) for way in ways],
        )
        for key, value in values.items():
            assert not np.isnan(value).any(), (key, state, dtype)
            assert all(np.isfinite(found[key]).all() for found in jacobians), (key, state, dtype)


def report_of(aspect_ratio, volume):
    """A report of triangles by their aspect ratio and volume."""
    some, flags = jnp.ones_like(volume), jnp.zeros(len(volume), bool)
    return jm.QualityReport(
        volume,
        some,
        aspect_ratio,
        *[some] * 4,
        flags,
        flags,
        jnp.zeros((len(volume), 2)),
        flags,
        flags,
        (("triangle", len(volume)),),
    )


def test_means_of_cells_without_volume():
    """A flat cell counts for nothing; an infinite value elsewhere, or NaN, is told; derivatives stay finite."""
    ratio = jnp.array([2.0, np.inf, 4.0])
    of = jax.jit(
        jax.value_and_grad(lambda *columns: report_of(*columns).mean_aspect_ratio, argnums=(0, 1))
    )
    value, slopes = of(ratio, jnp.array([1.0, 0.0, 3.0]))
    assert float(value) == 3.5
    np.testing.assert_allclose(slopes[0], [0.25, 0, 0.75], rtol=1e-15)
    np.testing.assert_allclose(slopes[1][::2], [(2 - 3.5) / 4, (4 - 3.5) / 4], rtol=1e-15)
    assert np.isfinite(slopes[1]).all()
    for bad, volume in ((jnp.inf, 1e-20), (jnp.nan, 1.0), (4.0, np.nan)):
        value, slopes = of(ratio.at[1].set(bad), jnp.array([1.0, volume, 3.0]))
        assert not np.isfinite(value)
        assert np.isfinite(slopes).all() == (bad == jnp.inf)


def test_derivatives_of_maxima():
    """Of the largest alone, shared by equal ones, whatever the compiler computes anew; twice too."""
    values = jnp.array([[1.0, 5.0, np.inf], [3.0, 5.0, -1.0], [-2.0, 0.0, 2.0]])
    np.testing.assert_array_equal(largest(values), np.max(values, axis=0))
    np.testing.assert_array_equal(smallest(values, 1), np.min(values, axis=1))
    slope = jax.jacrev(largest)(values)
    np.testing.assert_array_equal(np.sum(slope, axis=1), np.eye(3))
    np.testing.assert_array_equal(
        slope[[0, 1, 2], :, [0, 1, 2]], [[0, 1, 0], [0.5, 0.5, 0], [1, 0, 0]]
    )
    twice = jax.jit(jax.hessian(lambda x: largest(x**2)))(jnp.array([1.0, -3.0, 2.0]))
    np.testing.assert_array_equal(twice, np.diag([0.0, 2, 0]))


def test_surfaces_have_no_side():
    """Cells of a surface in 3-D are measured without a sign, however they are numbered."""
    mesh, _ = neighbours("quad in 3-D")
    report = jm.quality(mesh)
    assert int(report.inverted) == 0
    assert (np.asarray(report.jacobian) > 0).all()
