"""Every test runs in float64; those about float32 ask for it themselves."""

import resource

import jax
import pytest

jax.config.update("jax_enable_x64", True)


@pytest.fixture(autouse=True)
def stack_limit():
    """gmsh lifts it for good, and the threads of processes that later tests start would have too little of it."""
    limit = resource.getrlimit(resource.RLIMIT_STACK)
    yield
    resource.setrlimit(resource.RLIMIT_STACK, limit)
