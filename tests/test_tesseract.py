"""The example of a Tesseract, called through Tesseract's own client without a container."""

import pathlib

import numpy as np
import pytest

core = pytest.importorskip("tesseract_core")
FILE = pathlib.Path(__file__).parents[1] / "docs" / "examples" / "tesseract_api.py"


def cosine(a, b):
    a, b = np.ravel(a), np.ravel(b)
    return a @ b / (np.linalg.norm(a) * np.linalg.norm(b))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_products_are_the_derivatives_of_apply():
    """Cosine with central differences at least 1 - 1e-10, lengths to 1e-6, and the two products are transposes."""
    rng = np.random.default_rng(0)
    given = {"angle": np.float64(0.1), "control": 0.01 * rng.normal(size=(5, 3, 2))}
    tangent = {"angle": np.float64(0.3), "control": rng.normal(size=(5, 3, 2))}
    names = ["angle", "control"]
    with core.Tesseract.from_tesseract_api(FILE) as mover:
        points = mover.apply(given)["points"]
        assert points.dtype == np.float64
        h = 1e-5
        high, low = (
            mover.apply({k: given[k] + s * h * tangent[k] for k in names})["points"]
            for s in (1, -1)
        )
        difference = (high - low) / (2 * h)
        forward = mover.jacobian_vector_product(given, names, ["points"], tangent)["points"]
        assert cosine(forward, difference) >= 1 - 1e-10
        np.testing.assert_allclose(np.linalg.norm(forward), np.linalg.norm(difference), rtol=1e-6)
        weights = rng.normal(size=points.shape)
        reverse = mover.vector_jacobian_product(given, names, ["points"], {"points": weights})
        product = sum(np.vdot(reverse[name], tangent[name]) for name in names)
        np.testing.assert_allclose(product, np.vdot(weights, forward), rtol=1e-10)
