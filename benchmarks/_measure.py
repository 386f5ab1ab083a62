"""What every benchmark shares: interleaved runs, CPU time of the process, and a line about the machine."""

import importlib.metadata
import os
import pathlib
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Sequence

import jax


def cpu_seconds(functions: dict[str, Callable[[], object]], repeats: int = 7) -> dict[str, float]:
    """Median CPU time of each function, the runs interleaved so that a noisy moment hits all alike; the first is not counted."""
    times: dict[str, list[float]] = {name: [] for name in functions}
    for repeat in range(repeats + 1):
        for name, function in functions.items():
            began = time.process_time()
            jax.block_until_ready(function())
            if repeat:
                times[name].append(time.process_time() - began)
    return {name: statistics.median(values) for name, values in times.items()}


def once(function: Callable[[], object]) -> tuple[object, float, float]:
    """The result, and the CPU and wall seconds of one call."""
    cpu, wall = time.process_time(), time.perf_counter()
    result = jax.block_until_ready(function())
    return result, time.process_time() - cpu, time.perf_counter() - wall


def about(**what: object) -> None:
    """One line about the machine and versions, one about the case."""
    versions = ", ".join(
        f"{name} {importlib.metadata.version(name)}" for name in ("jax", "jaxlib", "numpy", "scipy")
    )
    load = f"load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "load unknown"
    print(f"{_processor()}, {os.cpu_count()} cores, {jax.default_backend()}, {load}; {versions}")
    print(
        f"XLA_FLAGS={os.environ.get('XLA_FLAGS', '')}; "
        + ", ".join(f"{name} = {value}" for name, value in what.items())
    )


def _processor() -> str:
    """The processor's name and kind, where the system tells."""
    facts = pathlib.Path("/proc/cpuinfo")
    lines = facts.read_text().splitlines() if facts.exists() else []
    names = {line.partition(":")[2].strip() for line in lines if line.startswith("model name")}
    return ", ".join([*sorted(names), platform.machine()])


def table(
    rows: Iterable[Sequence[str]], heads: Sequence[str] = ("what", "measured", "goal")
) -> None:
    """As Markdown, each row as it comes."""
    print("\n| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|")
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
