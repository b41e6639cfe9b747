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

from trajectory_calibration.se3 import FloatArray

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

    """

    levels: tuple[_Level, ...]
    root: FloatArray
    log_determinant: float

    @classmethod
    def factor(cls, diagonal: FloatArray, upper: FloatArray) -> BlockChain:
        """Factor the matrix with (N, n, n) diagonal and (N - 1, n, n) blocks to their right.

        Raises
        ------
        numpy.linalg.LinAlgError
            The matrix is not positive definite.

        """
        n = diagonal.shape[-1]
        levels = []
        log_determinant = 0.0
        D, E = diagonal, upper
        while len(D) > 1:
            odd, after = len(D) // 2, (len(D) - 1) // 2
            level = _Level(np.empty((odd, n, n)), np.zeros((odd, n, 2 * n)), len(D))
            evens, E_next = D[0::2].copy(), np.empty((after, n, n))
            for first, last, pairs in _pieces(odd, after):
                L = np.linalg.cholesky(D[2 * first + 1:2 * last:2])
                log_determinant += 2 * float(
                    np.log(np.diagonal(L, axis1=1, axis2=2)).sum())
                inverse_root = _inverse_of_lower(L)
                coupling = np.zeros((len(L), n, 2 * n))
                coupling[:, :, :n] = E[2 * first:2 * last:2].transpose(0, 2, 1)
                coupling[:pairs - first, :, n:] = E[2 * first + 1:2 * pairs:2]
                coupling = inverse_root @ coupling
                # A copy: of a matrix and its own transpose NumPy takes the slower product.
                update = coupling.transpose(0, 2, 1).copy() @ coupling
                level.inverse_root[first:last], level.coupling[first:last] = inverse_root, coupling
                evens[first:last] -= update[:, :n, :n]
                evens[first + 1:pairs + 1] -= update[:pairs - first, n:, n:]
                E_next[first:pairs] = -update[:pairs - first, :n, n:]
            levels.append(level)
            D, E = evens, E_next
        L = np.linalg.cholesky(D[0])
        log_determinant += 2 * float(np.log(np.diagonal(L)).sum())
        return cls(tuple(levels), np.linalg.inv(L), log_determinant)

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the (N, n, m) solution of the system with (N, n, m) right-hand sides."""
        n = self.root.shape[0]
        # All levels work in place: of a long chain, new arrays cost more than the sums in them.
        x = right.copy()
        for depth, level in enumerate(self.levels):
            evens, odds = x[::2 << depth], x[1 << depth::2 << depth]
            for first, last, pairs in _pieces(level.blocks // 2, (level.blocks - 1) // 2):
                half = level.inverse_root[first:last] @ odds[first:last]
                update = level.coupling[first:last].transpose(0, 2, 1) @ half
                evens[first:last] -= update[:, :n]
                evens[first + 1:pairs + 1] -= update[:pairs - first, n:]
                odds[first:last] = half
        x[0] = self.root.T @ (self.root @ x[0])
        for depth, level in reversed(list(enumerate(self.levels))):
            evens, odds = x[::2 << depth], x[1 << depth::2 << depth]
            for first, last, pairs in _pieces(level.blocks // 2, (level.blocks - 1) // 2):
                own = odds[first:last] - level.coupling[first:last, :, :n] @ evens[first:last]
                own[:pairs - first] -= (
                    level.coupling[first:pairs, :, n:] @ evens[first + 1:pairs + 1])
                odds[first:last] = level.inverse_root[first:last].transpose(0, 2, 1) @ own
        return x

    def partial_inverse(self) -> tuple[FloatArray, FloatArray]:
        """Return the (N, n, n) diagonal and (N - 1, n, n) right blocks of the inverse."""
        n = self.root.shape[0]
        S = (self.root.T @ self.root)[None]
        C = np.zeros((0, n, n))
        for level in reversed(self.levels):
            fine_S = np.empty((level.blocks, n, n))
            fine_C = np.empty((level.blocks - 1, n, n))
            fine_S[0::2] = S
            for first, last, pairs in _pieces(level.blocks // 2, (level.blocks - 1) // 2):
                joint = np.zeros((last - first, 2 * n, 2 * n))
                joint[:, :n, :n] = S[first:last]
                joint[:pairs - first, n:, n:] = S[first + 1:pairs + 1]
                joint[:pairs - first, :n, n:] = C[first:pairs]
                joint[:pairs - first, n:, :n] = C[first:pairs].transpose(0, 2, 1)
                root, coupling = level.inverse_root[first:last], level.coupling[first:last]
                root_t = root.transpose(0, 2, 1)
                cross = -(root_t @ coupling) @ joint
                # Copies: of a transpose on the right NumPy takes the slower product.
                V_t = coupling.transpose(0, 2, 1).copy() @ root
                fine_S[2 * first + 1:2 * last:2] = root_t.copy() @ root - cross @ V_t
                fine_C[2 * first:2 * last:2] = cross[:, :, :n].transpose(0, 2, 1)
                fine_C[2 * first + 1:2 * pairs:2] = cross[:pairs - first, :, n:]
            S, C = fine_S, fine_C
        return S, C


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


def _pieces(odd: int, after: int) -> Iterator[tuple[int, int, int]]:
    """Yield first and last of the odd blocks of a piece, and the last with a right neighbour.

    ``after`` of the blocks have one.
    """
    for first in range(0, odd, _PIECE):
        last = min(first + _PIECE, odd)
        yield first, last, min(last, after)
