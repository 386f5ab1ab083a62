"""What every test stands on: float64, broadcasts that are written out, compiled code that workers share."""

import collections
import contextlib
import os
import pathlib
import resource
import sys
import tempfile

import jax
import jaxtyping
import pytest
from memory import drop_compiled

if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
    # one folder of compiled code for the workers and for the processes that tests start; with a limit to its size JAX locks it
    FOLDER = tempfile.TemporaryDirectory(prefix="jaxmorph-compiled-")
    CACHE = {
        "jax_compilation_cache_dir": FOLDER.name,
        "jax_compilation_cache_max_size": 2**32,
        "jax_persistent_cache_min_compile_time_secs": 0.3,
    }
    for option, value in CACHE.items():
        os.environ[option.upper()] = str(value)
        jax.config.update(option, value)

elif "PYTEST_XDIST_WORKER" not in os.environ:
    # processes that tests killed have left entries without their time of use, which JAX cannot replace
    for entry in pathlib.Path(os.environ["JAX_COMPILATION_CACHE_DIR"]).glob("*-cache"):
        if not entry.with_name(f"{entry.name.removesuffix('-cache')}-atime").exists():
            entry.unlink(missing_ok=True)

if "JAX_DISABLE_MOST_OPTIMIZATIONS" not in os.environ:
    # most programs run once, on small meshes: compiling takes longer than running. .ci/nightly runs them as users have them
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "true"
    jax.config.update("jax_disable_most_optimizations", True)

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
sys.path.append(str(pathlib.Path(__file__).parents[1]))  # for meshes of benchmarks/

MEMORY = {}
"""Largest resident memory of each worker, bytes."""

LONG = (
    *("notebooks", "openfoam_runs", "wing", "fuzz", "compare", "improve", "conditioning"),
    *(
        "mpi",
        "halves",
        "cli_chunks",
        "free_faces",
        "agard445",
        "demo",
        "mphys",
        "tesseract",
        "docs",
        "one_core",
    ),
    *("native", "native_openfoam"),
)
"""Files of few tests, each of which takes long. They come first, so that no worker waits for another at the end."""

UNCOUNTED = (
    *("basis", "generated", "kernel_sum", "nearwall", "wallfit", "wing", "agard445", "cli"),
    *(
        "cli_chunks",
        "cli_compiled",
        "cli_help",
        "cli_picture",
        "demo",
        "mphys",
        "naca0015",
        "naca4",
    ),
    *("notebooks", "openmdao", "plot", "plot_sources"),
    *("shapes", "shapes_curves", "shapes_freeform", "shapes_measures", "shapes_smooth"),
)
"""Files whose tests run hardly a line of the core that others do not: `--cov`, which slows Python down, counts none there."""

_raises = pytest.raises


@contextlib.contextmanager
def raises(*expected, **keywords):
    """`pytest.raises`, without checks of types inside: wrong input is answered as users get it."""
    checked = not jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        with _raises(*expected, **keywords) as caught:
            yield caught
    finally:
        jaxtyping.config.update("jaxtyping_disable", not checked)


pytest.raises = raises


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config, items):
    """Puts the files that take longest first: a worker takes one after the other. Marks what `--cov` leaves out."""
    count = collections.Counter(item.path for item in items)
    is_long = {
        path: path.stem.removeprefix("test_") in LONG or path.parent.name in LONG for path in count
    }
    items.sort(key=lambda item: (not is_long[item.path], -count[item.path], item.path))
    if config.pluginmanager.hasplugin("_cov"):
        for item in items:
            if item.path.stem.removeprefix("test_") in UNCOUNTED:
                item.add_marker("no_cover")


@pytest.fixture
def folder(tmp_path):
    return tmp_path


@pytest.fixture
def here(folder, monkeypatch):
    """Makes `folder`, which a file of tests may fill, the current folder."""
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def closed_figures():
    """Closes all figures of matplotlib and all plotters of pyvista after a test."""
    yield
    import pyvista
    from matplotlib import pyplot

    pyplot.close("all")
    pyvista.close_all()


@pytest.fixture(autouse=True)
def stack_limit():
    """gmsh lifts it for good, and the threads of processes that later tests start would have too little of it."""
    limit = resource.getrlimit(resource.RLIMIT_STACK)
    yield
    resource.setrlimit(resource.RLIMIT_STACK, limit)


def pytest_runtest_teardown(item, nextitem):
    """Drops compiled code where it fills memory. Dropped after each file, small programs would be compiled 140 times."""
    drop_compiled()


def pytest_sessionfinish(session):
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (
        1 if sys.platform == "darwin" else 1024
    )
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["memory"] = largest
    else:
        MEMORY["this process"] = largest


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    MEMORY[node.gateway.id] = getattr(node, "workeroutput", {}).get("memory", 0)


def pytest_terminal_summary(terminalreporter):
    each = ", ".join(f"{name} {memory / 1e9:.2f} GB" for name, memory in sorted(MEMORY.items()))
    terminalreporter.write_line(f"memory: {each}")


@pytest.fixture
def figures(monkeypatch):
    """The figures of matplotlib that are saved."""
    figure = pytest.importorskip("matplotlib.figure").Figure
    saved, save = [], figure.savefig
    monkeypatch.setattr(
        figure,
        "savefig",
        lambda self, *args, **settings: saved.append(self) or save(self, *args, **settings),
    )
    return saved
