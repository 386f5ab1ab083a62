"""The names that extensions share with the package."""

import subprocess
import sys
import warnings

import numpy as np
import pytest

from jaxmorph import extend


def test_each_name_is_documented_and_found():
    for name in dir(extend):
        assert getattr(extend, name).__doc__, name
    star = {}
    exec("from jaxmorph.extend import *", star)
    assert {*dir(extend)} <= {*star}
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        extend.nothing  # noqa: B018


def test_files_need_no_jax():
    code = "import sys; from jaxmorph.extend import complete, input_path; assert 'jax' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_extension_checks_its_arguments(tmp_path):
    @extend.checked
    def scaled(values: list[float], factor: float = 1.0):
        extend.between("factor", factor, 0)
        return factor * extend.finite_array("values", values, (None,))

    np.testing.assert_array_equal(scaled([1, 2], 2), [2, 4])
    with pytest.raises(
        ValueError,
        match=r"`factor` must be a real number, not 'a'. Call .*scaled\(values, factor\)",
    ):
        scaled([1.0], "a")
    with pytest.raises(ValueError, match="`factor` must be a real number above 0"):
        scaled([1.0], -1.0)
    with pytest.raises(ValueError, match="1 of 2 numbers of `values` are not finite"):
        scaled([1.0, np.inf])


def test_warnings_name_the_line_of_the_caller():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        extend.warn("look")
    assert caught[0].filename == __file__


def test_one_process_speaks_with_itself():
    alone = extend.Alone()
    assert extend.together(alone, lambda: 3) == 3
    values = np.array([[1.0], [2.0], [1.5]])
    np.testing.assert_array_equal(
        extend.Agreement(alone)(np.array([4, 5, 4]), values), [[1], [2], [1]]
    )
