"""Block-tridiagonal systems by cyclic reduction: factor, solve, invert in part.

The normal equations of a chain of poses are symmetric positive definite and block-tridiagonal.
Odd-even (cyclic) reduction eliminates every second block at once, so that each of the
``log2 N`` levels is a handful of array operations: O(N) work and no loop over poses. A banded
Cholesky factorisation (LAPACK ``pbtrf``) is as fast for a solve, but the covariances of
neighbouring blocks, which the variances of the noise need, would then take a recursion pose by
pose; here they come back through the same levels.

G. H. Golub, C. F. Van Loan, "Matrix Computations", 4th edition, 2013, section 4.5.4; the partial
inverse is Takahashi's recursion over the levels, A. M. Erisman, W. F. Tinney, Communications of
the ACM 18(3), 1975, doi:10.1145/360680.360704.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.pool import Pool

# What NumPy says of the arrays that its linear algebra returns.
_Array = NDArray[np.floating[Any]]

# Blocks that are eliminated at once: what is made on the way stays in the cache of a core.
_PIECE = 1024
# Fewer triangles than this are inverted one by one: the calls would cost more than they save.
_FEW = 64


@dataclass(frozen=True, eq=False)
class _Level:
    """The elimination of the odd blocks of one level.

    Attributes
    ----------
    inverse_root : (m, n, n), L^-1 of the pivots ``L L^T``.
    coupling : (m, n, 2n), ``L^-1`` times the couplings to the left and the right neighbour; the
        right half of the last is zero where it has no right neighbour.
    blocks : number of blocks before the elimination.

    """

    inverse_root: FloatArray
    coupling: FloatArray
    blocks: int


@dataclass(frozen=True, eq=False)
class BlockChain:
    """A factorised symmetric positive definite block-tridiagonal matrix.

    Attributes
    ----------
    levels : from the finest to the coarsest.
    root : (n, n), the inverse Cholesky factor of the block that remains.
    log_determinant : of the whole matrix.
    pool : memory for solutions.

    """

    levels: tuple[_Level, ...]
    root: FloatArray
    log_determinant: float
    pool: Pool

    @classmethod
    def factor(
        cls, diagonal: FloatArray, upper: FloatArray, pool: Pool | None = None,
    ) -> BlockChain:
        """Factor the matrix with (N, n, n) diagonal and (N - 1, n, n) blocks to their right.

        Both are overwritten; ``pool`` has the memory for the rest.

        Raises
        ------
        numpy.linalg.LinAlgError
            The matrix is not positive definite.

        """
        n = diagonal.shape[-1]
        pool = pool or Pool()
        levels: list[_Level] = []
        log_determinant = 0.0
        blocks = len(diagonal)
        while blocks > 1:
            odd = blocks // 2
            level = _Level(pool.empty((odd, n, n)), pool.empty((odd, n, 2 * n)), blocks)
            evens, odds = _evens_and_odds(diagonal, len(levels))
            # To the right of the even ones; of the odd ones, but the last may have no neighbour.
            to_odds, to_evens = _evens_and_odds(upper, len(levels))
            for first, last, pairs in _pieces(blocks):
                L = np.linalg.cholesky(odds[first:last])
                log_determinant += 2 * float(
                    np.log(np.diagonal(L, axis1=1, axis2=2)).sum())
                inverse_root = _inverse_of_lower(L)
                coupling = np.zeros((len(L), n, 2 * n))
                coupling[:, :, :n] = to_odds[first:last].transpose(0, 2, 1)
                coupling[:pairs - first, :, n:] = to_evens[first:pairs]
                coupling = inverse_root @ coupling
                # A copy: of a matrix and its own transpose NumPy takes the slower product.
                update = coupling.transpose(0, 2, 1).copy() @ coupling
                level.inverse_root[first:last], level.coupling[first:last] = inverse_root, coupling
                evens[first:last] -= update[:, :n, :n]
                evens[first + 1:pairs + 1] -= update[:pairs - first, n:, n:]
                to_odds[first:pairs] = -update[:pairs - first, :n, n:]
            levels.append(level)
            blocks -= odd
        L = np.linalg.cholesky(diagonal[0])
        log_determinant += 2 * float(np.log(np.diagonal(L)).sum())
        return cls(tuple(levels), np.linalg.inv(L), log_determinant, pool)

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the (N, n, m) solution of the system with (N, n, m) right-hand sides."""
        n = self.root.shape[0]
        x = self._reduce(right)
        x[0] = self.root.T @ x[0]
        for depth, level in reversed(list(enumerate(self.levels))):
            evens, odds = _evens_and_odds(x, depth)
            for first, last, pairs in _pieces(level.blocks):
                own = odds[first:last] - level.coupling[first:last, :, :n] @ evens[first:last]
                own[:pairs - first] -= (
                    level.coupling[first:pairs, :, n:] @ evens[first + 1:pairs + 1])
                odds[first:last] = level.inverse_root[first:last].transpose(0, 2, 1) @ own
        return x

    def quadratic_form(self, right: FloatArray) -> FloatArray:
        """Return (m, m), the (N, n, m) right-hand sides times their solutions; half a solution."""
        x = self._reduce(right).reshape(-1, right.shape[2])
        product: FloatArray = x.T @ x
        return product

    def _reduce(self, right: FloatArray) -> FloatArray:
        """Return (N, n, m), the right-hand sides times the inverse root of the matrix."""
        n = self.root.shape[0]
        x = self.pool.empty(right.shape)
        x[...] = right
        for depth, level in enumerate(self.levels):
            evens, odds = _evens_and_odds(x, depth)
            for first, last, pairs in _pieces(level.blocks):
                half = level.inverse_root[first:last] @ odds[first:last]
                update = level.coupling[first:last].transpose(0, 2, 1) @ half
                evens[first:last] -= update[:, :n]
                evens[first + 1:pairs + 1] -= update[:pairs - first, n:]
                odds[first:last] = half
        x[0] = self.root @ x[0]
        return x

    def partial_inverse(self) -> tuple[FloatArray, FloatArray]:
        """Return the (N, n, n) diagonal and (N - 1, n, n) right blocks of the inverse."""
        n = self.root.shape[0]
        blocks = self.levels[0].blocks if self.levels else 1
        diagonal, upper = self.pool.empty((blocks, n, n)), self.pool.empty((blocks - 1, n, n))
        diagonal[0] = self.root.T @ self.root
        for depth, level in reversed(list(enumerate(self.levels))):
            evens, odds = _evens_and_odds(diagonal, depth)
            to_odds, to_evens = _evens_and_odds(upper, depth)
            for first, last, pairs in _pieces(level.blocks):
                joint = np.zeros((last - first, 2 * n, 2 * n))
                joint[:, :n, :n] = evens[first:last]
                joint[:pairs - first, n:, n:] = evens[first + 1:pairs + 1]
                # Of the coarser level: from even to even.
                joint[:pairs - first, :n, n:] = to_odds[first:pairs]
                joint[:pairs - first, n:, :n] = to_odds[first:pairs].transpose(0, 2, 1)
                root, coupling = level.inverse_root[first:last], level.coupling[first:last]
                root_t = root.transpose(0, 2, 1)
                cross = -(root_t @ coupling) @ joint
                # Copies: of a transpose on the right NumPy takes the slower product.
                V_t = coupling.transpose(0, 2, 1).copy() @ root
                odds[first:last] = root_t.copy() @ root - cross @ V_t
                to_odds[first:last] = cross[:, :, :n].transpose(0, 2, 1)
                to_evens[first:pairs] = cross[:pairs - first, :, n:]
        return diagonal, upper


def _evens_and_odds(blocks: FloatArray, depth: int) -> tuple[FloatArray, FloatArray]:
    """Return views of the even and of the odd blocks of a level: all of it happens in place.

    What leads from a block to the next one of its level stands where the block stands.
    """
    return blocks[::2 << depth], blocks[1 << depth::2 << depth]


def _inverse_of_lower(L: _Array) -> _Array:
    """Return the inverses of (m, n, n) lower triangular matrices.

    LAPACK inverts general matrices one by one: three times slower than all at once by halves.
    """
    if len(L) < _FEW:
        return np.linalg.inv(L)
    n = L.shape[-1]
    inverse = np.zeros_like(L)
    if n > 3:
        h = n // 2
        first, last = _inverse_of_lower(L[:, :h, :h]), _inverse_of_lower(L[:, h:, h:])
        inverse[:, :h, :h], inverse[:, h:, h:] = first, last
        inverse[:, h:, :h] = -last @ (L[:, h:, :h] @ first)
        return inverse
    for i in range(n):
        inverse[:, i, i] = 1 / L[:, i, i]
        for j in range(i):
            rest = sum(L[:, i, k] * inverse[:, k, j] for k in range(j, i))
            inverse[:, i, j] = -rest * inverse[:, i, i]
    return inverse


def _pieces(blocks: int) -> Iterator[tuple[int, int, int]]:
    """Yield first and last of the odd blocks of a piece, and the last with a right neighbour."""
    odd, after = blocks // 2, (blocks - 1) // 2
    for first in range(0, odd, _PIECE):
        last = min(first + _PIECE, odd)
        yield first, last, min(last, after)
