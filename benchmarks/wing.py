"""The paper's wing by the classic RBF too, every surface node a source: the table of `jaxmorph demo agard445` with one more row.

python benchmarks/wing.py [--points 64943]

At full size some 17,000 equations: 6 GB, and minutes on two cores.
"""

import argparse

import jax
from _measure import about

import jaxmorph as jm
from jaxmorph import cases
from jaxmorph._demo import _wing


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=_wing.POINTS)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    mesh = cases.agard445(points=arguments.points)
    about(n=len(mesh.points), b=len(mesh.patch("wing")) + len(mesh.patch("farfield")))
    every = jm.RBF.classic()
    studies = [*_wing.compare(), _wing.Study("classic RBF", every, "classic")]
    print(_wing._tables(mesh, jm.quality(mesh), [_wing.measure(mesh, study) for study in studies]))


if __name__ == "__main__":
    main()
