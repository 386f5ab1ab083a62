"""Which run holds which cases of a law: the fast tests, `.ci/run` or `.ci/nightly`."""

import pytest


def runs(fast=(), slow=(), nightly=()) -> list:
    """Lists cases for `parametrize`, marked by the run that holds them. A case of several arguments is a tuple."""
    marked = [*((case, ()) for case in fast), *((case, pytest.mark.slow) for case in slow)]
    marked += [(case, pytest.mark.nightly) for case in nightly]
    return [pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=marks) for case, marks in marked]
