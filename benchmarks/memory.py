"""What `deform` and its derivatives set aside beside their results, from the compiled program: it must not grow as n x s.

python benchmarks/memory.py
"""

import argparse

import equinox as eqx
import jax
import jax.numpy as jnp
from _cases import displacements, plan_of
from _measure import about
from files import box

import jaxmorph as jm


def scalar(points):
    return jnp.sum(points**2)


FUNCTIONS = {
    "deform": jm.deform,
    "pullback": lambda plan, u: jm.pullback(plan, u, plan.points),
    "jax.grad by u": lambda plan, u: jax.grad(lambda u: scalar(jm.deform(plan, u)))(u),
    "jax.grad by the base points": lambda plan, u: jax.grad(
        lambda x: scalar(jm.deform(jm.refit(plan, x), u))
    )(plan.points),
}


def temporary(function, n: int, s: int) -> float:
    plan = plan_of(n, s)
    arrays, static = eqx.partition(plan, eqx.is_array)
    traced = jax.jit(lambda arrays, u: function(eqx.combine(arrays, static), u))
    return (
        traced.lower(arrays, displacements(plan)).compile().memory_analysis().temp_size_in_bytes
        / 1e6
    )


def of_quality(side: int) -> tuple[float, float]:
    """Of one measure of side^3 hexahedra, and of its gradient by the points."""
    mesh = box(side + 1)

    def measure(points):
        return jm.quality(mesh, points).mean_skewness

    programs = (
        jax.jit(function).lower(jnp.asarray(mesh.points)).compile()
        for function in (measure, jax.grad(measure))
    )
    value, gradient = (program.memory_analysis().temp_size_in_bytes / 1e6 for program in programs)
    return value, gradient


def main() -> None:
    argparse.ArgumentParser(description=__doc__.splitlines()[0]).parse_args()
    jax.config.update("jax_enable_x64", True)
    about(dtype="float64", units="MB")
    sizes = [(100_000, 300), (1_000_000, 300), (1_000_000, 1_000)]
    print(
        "\n| what | "
        + " | ".join(f"n = {n:,}, s = {s:,}" for n, s in sizes)
        + " |\n|---|---|---|---|"
    )
    for name, function in FUNCTIONS.items():
        print(
            f"| {name} | "
            + " | ".join(f"{temporary(function, *size):.0f}" for size in sizes)
            + " |",
            flush=True,
        )
    print("| one array (n, 3) | " + " | ".join(f"{24e-6 * n:.0f}" for n, _ in sizes) + " |")
    print(
        "| the kernel matrix (n, s) | " + " | ".join(f"{8e-6 * n * s:.0f}" for n, s in sizes) + " |"
    )
    value, gradient = of_quality(100)
    print(
        f"\nquality of 1,000,000 hexahedra, one measure: {value:.0f}; its gradient: {gradient:.0f}"
    )


if __name__ == "__main__":
    main()
