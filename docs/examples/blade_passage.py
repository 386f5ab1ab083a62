"""A blade between periodic sides, its tip five cells below a shroud: held boundaries against such that slide and repeat.

In a checkout: `python -m docs.examples.blade_passage`. The mesh turns about x; the hub's radius is 1, the shroud's 2. Prints:

    10 degrees, held: 0 inverted, smallest ratio 0.46
    10 degrees, slides and repeats: 0 inverted, smallest ratio 0.96
    20 degrees, held: 4 inverted, smallest ratio -0.10
    20 degrees, slides and repeats: 0 inverted, smallest ratio 0.90
    40 degrees, held: 40 inverted, smallest ratio -1.39
    40 degrees, slides and repeats: 0 inverted, smallest ratio 0.73
    1.0000, -5.524e-04 per degree, central difference -5.524e-04
"""

import jax
import jax.numpy as jnp
import numpy as np

import jaxmorph as jm
from benchmarks import faults

jax.config.update("jax_enable_x64", True)
mesh = faults.blade_tip(gap=0.01, layers=5)
fixed = ("hub", "inlet", "outlet")
shroud = jm.Slide("shroud", jm.Revolution(axis=(1, 0, 0)))
sides = jm.Periodic("left", "right", axis=(1, 0, 0))
plan = jm.prepare(mesh, "blade", fixed, sliding=shroud, periodic=sides)
held = jm.prepare(mesh, "blade", (*fixed, "shroud", "left", "right"))
blade = plan.points[plan.moving]
radius = jnp.linalg.norm(blade[:, 1:], axis=1)


def twist(degrees):
    """Turns each section about a radial line, by an angle that grows to `degrees` at the tip; radii stay."""
    turned = jm.shapes.rotate(
        blade, jnp.radians(degrees) * (radius - 1), about=(0, 0, 0), axis=(0, 0, 1)
    )
    stretch = radius / jnp.linalg.norm(turned[:, 1:], axis=1)
    return turned.at[:, 1:].multiply(stretch[:, None]) - blade


for degrees in (10, 20, 40):
    for name, each in (("held", held), ("slides and repeats", plan)):
        report = jm.quality(mesh, jm.deform(each, twist(degrees)))
        print(
            f"{degrees} degrees, {name}: {report.inverted} inverted, smallest ratio {report.min_jacobian_ratio:.2f}"
        )

# The distance to the next blade, a sector further, at half the span, and its derivative.
sector = jnp.array([[1, 0, 0], [0, np.cos(0.8), np.sin(0.8)], [0, -np.sin(0.8), np.cos(0.8)]])
section = plan.moving[np.argsort(np.abs(radius - 1.5))[:40]]


def throat(degrees):
    points = jm.deform(plan, twist(degrees))[section]
    apart = jnp.linalg.norm((points @ sector.T)[:, None] - points[None], axis=2)
    return -jm.soft_maximum(-apart.ravel(), 200.0)


difference = (throat(8.01) - throat(7.99)) / 0.02
print(
    f"{throat(8.0):.4f}, {jax.grad(throat)(8.0):.3e} per degree, central difference {difference:.3e}"
)
