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

from dataclasses import dataclass

import numpy as np

from trajectory_calibration.se3 import FloatArray


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
            L = np.linalg.cholesky(D[1::2])
            log_determinant += 2 * float(
                np.log(np.diagonal(L, axis1=1, axis2=2)).sum())
            inverse_root = np.linalg.inv(L)
            coupling = np.zeros((len(L), n, 2 * n))
            coupling[:, :, :n] = E[0::2].transpose(0, 2, 1)
            coupling[:len(E) // 2, :, n:] = E[1::2]
            coupling = inverse_root @ coupling
            levels.append(_Level(inverse_root, coupling, len(D)))
            update = coupling.transpose(0, 2, 1) @ coupling
            D = D[0::2].copy()
            D[:len(L)] -= update[:, :n, :n]
            pairs = len(D) - 1
            D[1:] -= update[:pairs, n:, n:]
            E = -update[:pairs, :n, n:]
        L = np.linalg.cholesky(D[0])
        log_determinant += 2 * float(np.log(np.diagonal(L)).sum())
        return cls(tuple(levels), np.linalg.inv(L), log_determinant)

    def solve(self, right: FloatArray) -> FloatArray:
        """Return the (N, n, m) solution of the system with (N, n, m) right-hand sides."""
        n = self.root.shape[0]
        halves = []
        for level in self.levels:
            half = level.inverse_root @ right[1::2]
            halves.append(half)
            update = level.coupling.transpose(0, 2, 1) @ half
            right = right[0::2].copy()
            right[:len(half)] -= update[:, :n]
            right[1:] -= update[:len(right) - 1, n:]
        x = (self.root.T @ (self.root @ right[0]))[None]
        for level, half in zip(reversed(self.levels), reversed(halves), strict=True):
            fine = np.empty((level.blocks, n, x.shape[2]))
            fine[0::2] = x
            own = half - level.coupling[:, :, :n] @ x[:len(half)]
            after = len(x) - 1
            own[:after] -= level.coupling[:after, :, n:] @ x[1:]
            fine[1::2] = level.inverse_root.transpose(0, 2, 1) @ own
            x = fine
        return x

    def partial_inverse(self) -> tuple[FloatArray, FloatArray]:
        """Return the (N, n, n) diagonal and (N - 1, n, n) right blocks of the inverse."""
        n = self.root.shape[0]
        S = (self.root.T @ self.root)[None]
        C = np.zeros((0, n, n))
        for level in reversed(self.levels):
            odd, even = level.blocks // 2, len(S)
            joint = np.zeros((odd, 2 * n, 2 * n))
            joint[:, :n, :n] = S[:odd]
            joint[:even - 1, n:, n:] = S[1:]
            joint[:even - 1, :n, n:] = C
            joint[:even - 1, n:, :n] = C.transpose(0, 2, 1)
            V = level.inverse_root.transpose(0, 2, 1) @ level.coupling
            cross = -V @ joint
            fine_S = np.empty((level.blocks, n, n))
            fine_S[0::2] = S
            fine_S[1::2] = (level.inverse_root.transpose(0, 2, 1) @ level.inverse_root
                            - cross @ V.transpose(0, 2, 1))
            fine_C = np.empty((level.blocks - 1, n, n))
            fine_C[0::2] = cross[:, :, :n].transpose(0, 2, 1)
            fine_C[1::2] = cross[:even - 1, :, n:]
            S, C = fine_S, fine_C
        return S, C
