"""The share of an accelerator's peaks that `deform`, `pullback`, `refit`, 100 fields and `quality` reach, and their error.

python benchmarks/gpu.py [--n 10000000] [--s 300] [--side 200] [--peak BANDWIDTH_GB_S FLOAT64_TFLOP_S]

Without an accelerator the programs are exported for CUDA instead, and the steps that they take one after the other are counted.
"""

import argparse
import re
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from _cases import displacements, plan_of

import jaxmorph as jm

PEAKS = {
    "Tesla V100-SXM2-16GB": (900, 7.8),
    "Tesla V100-SXM2-32GB": (900, 7.8),
    "NVIDIA A100-PCIE-40GB": (1555, 9.7),
    "NVIDIA A100-SXM4-40GB": (1555, 9.7),
    "NVIDIA A100 80GB PCIe": (1935, 9.7),
    "NVIDIA A100-SXM4-80GB": (2039, 9.7),
    "NVIDIA H100 PCIe": (2000, 26),
    "NVIDIA H100 80GB HBM3": (3350, 34),
    "NVIDIA H200": (4800, 34),
    "NVIDIA L40S": (864, 1.4),
    "NVIDIA GeForce RTX 4090": (1008, 1.3),
    "AMD Instinct MI300X": (5300, 81.7),
}
"""By exact kind of device: bandwidth in GB/s, and float64 peak in TFLOP/s without tensor cores, of the makers' data sheets."""

PAIR = 40
"""Operations of a pair: 8 for the distance, 26 for the logarithm and its product, 6 for the sum of three components."""

CELL = 2500
"""Operations of a hexahedron's measures."""


def many(plan, u):
    return jax.vmap(jm.deform, (None, 0))(plan, u)


def measured(mesh, points):
    return jm.quality(mesh, points).skewness


def programs(n: int, s: int) -> Iterator[tuple[str, Callable, tuple, float, float]]:
    """Yields name, function, arguments, and the operations and bytes that it cannot do without."""
    plan = plan_of(n, s)
    u, points = displacements(plan), plan.points
    sweep, pairs = 48 * n, PAIR * n * s
    yield "deform", jm.deform, (plan, u), pairs, sweep
    yield "pullback", jm.pullback, (plan, u, points), pairs, sweep
    yield "refit", jm.refit, (plan, points), s**3, sweep
    yield "100 fields", many, (plan, displacements(plan, 100)), (PAIR + 594) * n * s, 51 * sweep / 2


def of_cells(side: int) -> tuple[str, Callable, tuple, float, float]:
    """The same of `quality`, for side^3 hexahedra."""
    from files import box

    mesh = box(side + 1)
    cells = side**3
    return (
        f"quality, {cells:,} cells",
        measured,
        (mesh, jnp.asarray(mesh.points)),
        CELL * cells,
        80 * cells,
    )


def grown(tree: Any, rows: int, n: int) -> Any:
    """The shapes of a tree whose leaves of `rows` rows have n."""

    def shape(leaf):
        first = (n,) if leaf.ndim and leaf.shape[0] == rows else leaf.shape[:1]
        return jax.ShapeDtypeStruct((*first, *leaf.shape[1:]), leaf.dtype)

    return jax.tree.map(shape, tree)


def steps(function: Callable, arguments: tuple, platform: str = "cuda") -> int:
    """Exports a program, and counts the rounds of its loops. A loop within another counts as often as the outer one goes round."""
    arrays, static = eqx.partition(arguments, lambda leaf: hasattr(leaf, "dtype"))
    traced = jax.jit(lambda arrays: function(*eqx.combine(arrays, static)))
    exported = jax.export.export(traced, platforms=[platform])(arrays)
    return rounds(exported.mlir_module())


def rounds(program: str) -> int:
    """Counts the rounds of the loops of a StableHLO program; a loop's bound is the constant that its counter is compared with."""
    functions: dict[
        str, Counter
    ] = {}  # rounds of a function's loops under "", and calls of others under their names
    name, constants, around, waiting, depth = "", {}, [(-1, 1)], None, 0
    for line in program.splitlines():
        if found := re.search(r"func\.func \w+ @([\w.]+)\(", line):
            name, constants = found[1], {}
        inside = functions.setdefault(name, Counter())
        if found := re.search(r"(%\w+) = stablehlo\.constant dense<(\d+)> : tensor<i\d+>", line):
            constants[found[1]] = int(found[2])
        if "stablehlo.while" in line:
            waiting = depth
        found = re.search(r"stablehlo\.compare\s+LT, %\w+, (%\w+),", line)
        if found and waiting is not None:
            around.append((waiting, around[-1][1] * constants[found[1]]))
            inside[""] += around[-1][1]
            waiting = None
        for called in re.findall(r"call @([\w.]+)\(", line):
            inside[called] += around[-1][1]
        depth += line.count("{") - line.count("}")
        while depth <= around[-1][0]:
            around.pop()

    def total(name: str) -> int:
        calls = functions.get(name, Counter())
        return sum(count * (total(called) if called else 1) for called, count in calls.items())

    return total("main")


def without_device(n: int, s: int) -> None:
    small = 2 * s
    print("\n| program, exported for CUDA | steps one after the other | for a CPU |\n|---|---|---|")
    for name, function, arguments, *_ in programs(small, s):
        shapes = grown(arguments, small, n)
        print(
            f"| {name} | {steps(function, shapes):,} | {steps(function, shapes, 'cpu'):,} |",
            flush=True,
        )
    name, function, arguments, *_ = of_cells(45)
    print(f"| {name} | {steps(function, arguments)} | {steps(function, arguments, 'cpu')} |")


def seconds(function: Callable, repeats: int = 5) -> float:
    jax.block_until_ready(function())
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        jax.block_until_ready(function())
        times.append(time.perf_counter() - began)
    return min(times)


def against_cpu(program: str, n: int, s: int) -> float:
    """The largest difference between the device's result and the CPU's, relative to the largest value."""
    results = []
    for device in (jax.devices()[0], jax.devices("cpu")[0]):
        with jax.default_device(device):
            found = {name: call(*given) for name, call, given, *_ in programs(n, s)}
            leaves = [
                leaf
                for leaf in jax.tree.leaves(found[program])
                if jnp.issubdtype(leaf.dtype, jnp.floating)
            ]
            results.append([np.asarray(leaf) for leaf in leaves])
    return max(
        np.abs(a - b).max() / max(np.abs(b).max(), 1e-300)
        for a, b in zip(*results, strict=True)
        if a.size
    )


def on_device(n: int, s: int, side: int, peak: tuple[float, float]) -> None:
    bandwidth, flops = peak
    print(
        "\n| what | ms | share of the memory's bandwidth | share of the float64 peak | difference from the CPU |"
    )
    print("|---|---|---|---|---|")
    for name, function, arguments, operations, traffic in (*programs(n, s), of_cells(side)):
        arrays, static = eqx.partition(arguments, eqx.is_array)
        call = jax.jit(
            lambda arrays, function=function, static=static: function(*eqx.combine(arrays, static))
        )
        took = seconds(lambda call=call, arrays=arrays: call(arrays))
        difference = (
            f"{against_cpu(name, 20_000, s):.0e}" if not name.startswith("quality") else "-"
        )
        shares = f"{traffic / took / bandwidth / 1e9:.0%} | {operations / took / flops / 1e12:.0%}"
        print(f"| {name} | {1e3 * took:.1f} | {shares} | {difference} |", flush=True)


def main() -> None:
    from _measure import about

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--n", type=int, default=10_000_000)
    parser.add_argument("--s", type=int, default=300)
    parser.add_argument("--side", type=int, default=200)
    parser.add_argument("--peak", type=float, nargs=2)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    device = jax.devices()[0]
    about(n=arguments.n, s=arguments.s, dtype="float64", device=device.device_kind)
    if device.platform == "cpu":
        return without_device(arguments.n, arguments.s)
    peak = arguments.peak or PEAKS.get(device.device_kind)
    if peak is None:
        parser.error(
            f"the peaks of {device.device_kind} are not known: pass --peak BANDWIDTH_GB_S FLOAT64_TFLOP_S."
        )
    on_device(arguments.n, arguments.s, arguments.side, peak)


if __name__ == "__main__":
    main()
