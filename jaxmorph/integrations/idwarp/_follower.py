"""A piece of a mesh that follows the points of a surface, whichever process has them."""

import dataclasses
from typing import Any

import numpy as np

from ..._kernels.compile import float64_mode
from .. import mpi


class Follower:
    """Moves the mesh with the surface's points; this process has the points `coordinates` (k, 3).

    `weights` (m, s) lead from the points of all processes to the moving nodes of the whole mesh.
    """

    def __init__(self, piece: mpi.Piece, weights: Any, points: np.ndarray):
        self.piece, self.weights, self.points = piece, weights, points
        self.coordinates = points.copy()
        counts = piece.comm.allgather(len(points))
        self.first = sum(counts[: piece.comm.rank])
        self.copies = dataclasses.replace(piece, is_owner=np.ones_like(piece.is_owner))

    def deform(self, dof: int = 0, step: float = 0.0) -> np.ndarray:
        """Moves the piece, with a step of one coordinate of the points of all processes."""
        with float64_mode():
            return self.piece.deform(self._u(self._displacement(dof, step)))

    def pushforward(self, tangent: np.ndarray) -> np.ndarray:
        with float64_mode():
            return self.piece.pushforward(self._u(self._displacement()), self._u(tangent))

    def pullback(self, cotangent: np.ndarray) -> np.ndarray:
        """Pulls back a derivative by all processes' nodes: derivatives by a shared node add up."""
        with float64_mode():
            share = self.copies.pullback(self._u(self._displacement()), cotangent)
        moving = np.zeros((self.weights.shape[0], 3))
        for rows, values in self.piece.comm.allgather((self.piece.rows, share)):
            moving[rows] = values
        total = self.weights.T @ moving
        return total[self.first : self.first + len(self.points)]

    def _displacement(self, dof: int = 0, step: float = 0.0) -> np.ndarray:
        u = self.coordinates - self.points
        if 0 <= dof - 3 * self.first < u.size:
            u.ravel()[dof - 3 * self.first] += step
        return u

    def _u(self, values: np.ndarray) -> np.ndarray:
        """Takes a motion of this process' points to the moving nodes that it has."""
        everywhere = np.concatenate(self.piece.comm.allgather(values))
        return (self.weights @ everywhere)[self.piece.rows]
