"""What a reduced field misses on the surface, against the number of its sources, by the way in which they are chosen.

    python benchmarks/sources.py [--points 39666] [--picture docs/sources.png] [--seconds 300]

An airfoil is cambered, waved, raised in one place and has its flap turned; a wing bends, twists and waves. A row holds the
largest miss at any node of the moving surface in any of the motions, then the mean one, relative to each motion's largest
displacement. The field is a thin plate spline with a linear polynomial, 40 sources on the fixed boundary and no correction. The
greedy choices by the motions are told of all of them. `--seconds` asks instead what the choice of so many of 16,230 nodes costs.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import agard445
import jax
import matplotlib.pyplot as plt
import numpy as np
from _measure import about, table
from _walls import bump, camber, flap, up

import jaxmorph as jm
from jaxmorph import cases, plot

COUNTS = (8, 16, 32, 64, 128)
FIXED = 40


def airfoil(points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    mesh = cases.naca0015(points=points)
    base = np.asarray(mesh.points)[mesh.patch("airfoil")]
    waves = [up(base, 0.02 * np.sin(k * np.pi * base[:, 0]))[0] for k in (3, 6)]
    motions = [camber(base, 0.05)[0], waves[0], bump(base, 0.03)[0], waves[1], flap(base, 10)[0]]
    return base, np.asarray(mesh.points)[mesh.patch("farfield")], np.stack(motions)


def wing(points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    mesh = cases.wing(points=max(300, points // 4), stations=13)
    base = np.asarray(mesh.points)[mesh.patch("wing")]
    share = np.abs(base[:, 1]) / np.abs(base[:, 1]).max()
    heights = [
        0.2 * share**2,
        0.05 * np.sin(2 * np.pi * share),
        0.1 * base[:, 0] * share,
        0.05 * np.sin(5 * base[:, 0]),
    ]
    return (
        base,
        np.asarray(mesh.points)[mesh.patch("farfield")],
        np.stack([up(base, height)[0] for height in heights]),
    )


def families(motions: np.ndarray) -> dict[str, Callable[[int, np.ndarray], jm.AbstractReduction]]:
    """Reductions by name, for a number of sources and the nodes of the wall."""
    return {
        "k-d tree": lambda count, base: jm.KDTree.with_sources(count, base),
        "farthest": lambda count, base: jm.FarthestPoints(count, extremes=True),
        "f-greedy": lambda count, base: jm.Greedy(count, motions, group=0.0),
        "f-greedy, grouped": lambda count, base: jm.Greedy(count, motions),
    }


class Errors(NamedTuple):
    """Misses of the moving nodes over the largest displacement, by reduction; `sources` on the wall."""

    sources: np.ndarray
    largest: np.ndarray
    mean: np.ndarray


def errors(base: np.ndarray, fixed: np.ndarray, motions: np.ndarray) -> dict[str, Errors]:
    """Measures, for each reduction, the largest miss in any motion and the mean one, against the sources on the wall."""
    points, moving = np.concatenate([base, fixed]), np.arange(len(base))
    still, sizes = np.arange(len(base), len(points)), np.linalg.norm(motions, axis=2).max(axis=1)
    found = {}
    for name, make in families(motions).items():
        rows = []
        for count in (count for count in COUNTS if count < len(base)):
            method = jm.RBF(reduction=make(count, base), fixed_reduction=jm.FarthestPoints(FIXED))
            plan = jm.prepare(points, moving, still, method=method)
            moved = [np.asarray(jm.deform(plan, u))[moving] - base for u in motions]
            missed = np.linalg.norm(np.array(moved) - motions, axis=2) / sizes[:, None]
            rows.append((len(plan.sources) - FIXED, missed.max(), missed.mean(axis=1).mean()))
        found[name] = Errors(*map(np.array, zip(*rows, strict=True)))
    return found


def draw(ax: Any, found: dict[str, Errors]) -> None:
    """Draws the largest errors as lines, the mean ones dashed, on logarithmic scales."""
    for k, (name, error) in enumerate(found.items()):
        colour = (plot.BLUE, plot.ORANGE, plot.GREEN, plot.DARK)[k]
        order, style = np.argsort(error.sources), {"color": colour, "marker": "osD^"[k]}
        ax.loglog(error.sources[order], error.largest[order], "-", label=name, **style)
        ax.loglog(error.sources[order], error.mean[order], "--", fillstyle="none", **style)
    ax.set_xticks(COUNTS, list(map(str, COUNTS)))
    ax.minorticks_off()
    ax.set_ylabel("error on the surface /\nlargest displacement")
    ax.grid(color="#dddddd")
    for line, marks, name in (("-", "full", "largest"), ("--", "none", "mean")):
        ax.plot([], [], f"o{line}", color=plot.GREY, fillstyle=marks, label=name)


def seconds(count: int) -> None:
    mesh, rows = agard445.mesh(), []
    base = np.asarray(mesh.points)[mesh.patch("wing")]
    motions = np.stack([agard445.mode(base, mode, 0.25) for mode in (1, 2)])
    for name in ("farthest", "f-greedy", "f-greedy, grouped"):
        make, began = families(motions)[name], time.process_time()
        make(count, base)(base)
        rows.append([name, f"{time.process_time() - began:.2f}"])
    table(rows, (f"{count} of {len(base)} nodes", "CPU seconds"))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--points", type=int, default=39_666)
    parser.add_argument("--picture", help="file of a picture to draw")
    parser.add_argument("--seconds", type=int, help="number of sources")
    asked = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    about(points=asked.points)
    if asked.seconds:
        seconds(asked.seconds)
        return
    parts = {"airfoil": airfoil(asked.points), "wing": wing(asked.points)}
    found = {name: errors(*part) for name, part in parts.items()}
    for name, families_of in found.items():
        for quantity in ("largest", "mean"):
            print(f"\n{name}, {len(parts[name][0])} nodes, {quantity} error")
            rows = [
                [
                    family,
                    *(
                        f"{count}: {error:.2g}"
                        for count, error in zip(each.sources, getattr(each, quantity), strict=True)
                    ),
                ]
                for family, each in families_of.items()
            ]
            table(rows, ("reduction", *(f"{count} asked" for count in COUNTS)))
    if asked.picture:
        figure, axes = plt.subplots(2, 1, figsize=(5, 6.4), sharex=True, layout="constrained")
        for ax, letter, (name, each) in zip(axes, "ab", found.items(), strict=True):
            draw(ax, each)
            ax.set_xlabel("sources")
            ax.text(
                0.03, 0.04, f"{letter}  {name}, {len(parts[name][0])} nodes", transform=ax.transAxes
            )
        figure.legend(
            *axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False
        )
        figure.savefig(asked.picture, dpi=160)


if __name__ == "__main__":
    main()
