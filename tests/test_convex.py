"""Second derivatives by singular values against those of the whole energy, with LAPACK's eigenvalues for the positive part."""

import jax
import jax.numpy as jnp
import numpy as np
from runs import over

from jaxmorph._improve.hessian import blocks, rotations, symmetric_eigen
from jaxmorph._quality.distortion import energy
from jaxmorph._quality.vector import Vector


def matrices(d, n=40):
    """Any, and the hard ones: zero, the identity, a reflection, nearly flat, of rank one, with equal singular values."""
    rng = np.random.default_rng(d)
    found = rng.normal(size=(n, d, d))
    found[:3] = np.zeros((d, d)), np.eye(d), np.diag([1, -1, 1][:d])
    found[3:6] = np.diag([1, 1e-9, 1][:d]), np.ones((d, d)), np.linalg.qr(found[5])[0]
    return found


def columns(stack):
    return [Vector([jnp.asarray(stack[None, :, i, b]) for i in range(stack.shape[2])]) for b in range(stack.shape[2])]


def together(vectors):
    return np.stack([np.stack([np.asarray(c)[0] for c in vector], axis=1) for vector in vectors], axis=2)


@over("d", [2], nightly=[3])
def test_rotations_and_singular_values(d):
    stack = matrices(d)
    u, sigma, v = rotations(columns(stack))
    left, right, middle = together(u), together(v), np.stack([np.asarray(s)[0] for s in sigma], axis=1)
    np.testing.assert_allclose(np.linalg.det(left), 1, atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(right), 1, atol=1e-12)
    np.testing.assert_allclose(np.einsum("nia,na,nja->nij", left, middle, right), stack, atol=1e-12)
    np.testing.assert_allclose(np.abs(middle), np.linalg.svd(stack, compute_uv=False), atol=1e-12)
    values, _ = symmetric_eigen([[jnp.asarray(stack + stack.mT)[None, :, i, j] for j in range(d)] for i in range(d)])
    values = np.sort(np.stack([np.asarray(x)[0] for x in values], axis=1))
    np.testing.assert_allclose(values, np.linalg.eigvalsh(stack + stack.mT), atol=1e-12)


@over("d floor", [(2, 0.0)], slow=[(3, 0.0)], nightly=[(3, -np.inf)])
def test_blocks_are_the_second_derivatives(d, floor):
    stack, rng = matrices(d), np.random.default_rng(10)
    inverse = rng.normal(size=(d, d, len(stack)))

    def of(squared, tau):
        return energy(squared, tau, 0.1, 0.5, d)

    def flat(t):
        m = t.reshape(d, d)
        tau = m[0, 0] * m[1, 1] - m[0, 1] * m[1, 0] if d == 2 else jnp.dot(m[0], jnp.cross(m[1], m[2]))
        return of(jnp.sum(t**2) / d, tau)

    values, vectors = np.linalg.eigh(jax.jit(jax.vmap(jax.hessian(flat)))(stack.reshape(-1, d * d)))
    hessian = np.einsum("nip,np,njp->nij", vectors, np.maximum(values, floor), vectors).reshape(-1, d, d, d, d)
    expected = np.einsum("nabef,cbn,zfn->aeczn", hessian, inverse, inverse)
    rows = [[jnp.asarray(row[None]) for row in rows] for rows in inverse]
    found = jax.jit(lambda: blocks(of, columns(stack), rows, floor))()[:, :, :, :, 0]
    np.testing.assert_allclose(found, expected, atol=1e-11 * np.abs(expected).max())
