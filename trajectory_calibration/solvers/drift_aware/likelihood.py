"""The restricted marginal likelihood at a fixed linearisation, with its derivatives.

With residuals ``e = r + J xi + G g`` of covariance R, bodies xi and global parameters g, the
restricted likelihood integrates both out:

    -2 log L = log|R| + log|H| + min over (xi, g) of e^T R^-1 e,    H = [J G]^T R^-1 [J G].

Its derivatives by the log variances theta_i, ``R_i = dR/dtheta_i``, are

    score_i = tr(P R_i) - y^T P R_i P y,    information_ij = 1/2 y^T P R_i P R_j P y,

P the projected inverse covariance; the second is the average information of A. R. Gilmour,
R. Thompson, B. R. Cullis, Biometrics 51(4), 1995, doi:10.2307/2533274. Both need no more than
the solution, neighbouring blocks of the inverse, and one further solution for each variance.

The scale s of b needs one more term. It multiplies noisy positions, so that least squares, and
the variances with it, would rather shrink the noise than explain it. The density of what b
reported, not of what s makes of it, has the factor ``s^T``: T is half the number of equations
that noise of translation leaves over, because half of that noise is taken to come from b.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from trajectory_calibration.geometry.se3 import FloatArray
from trajectory_calibration.solvers.drift_aware.block_chain import BlockChain
from trajectory_calibration.solvers.drift_aware.model import (
    Chain,
    IndexArray,
    Linearisation,
    linearise,
    PARAMETERS,
    State,
    TERM_COLUMNS,
)
from trajectory_calibration.solvers.drift_aware.noise import COMPONENTS, Noise, WHITE
from trajectory_calibration.solvers.linear import gram

# Poses that are linearised at once: the blocks of one piece stay in the cache of a core.
PIECE = 2048
# Runs of consecutive poses whose parts of the gradient are compared.
BLOCKS = 20
# Of a direction in which nothing was observed, m^2 or rad^2: more than any vehicle measures.
FREE_VARIANCE = 1e6
# Relative size of eigenvalues that rounding leaves of zero.
_ROUNDING = 1e-13


@dataclass(frozen=True, eq=False)
class Evaluation:
    """The likelihood and everything that a step needs; m global parameters are estimated.

    Attributes
    ----------
    objective : -2 log of the restricted likelihood, up to a constant.
    covariance : (m, m), of the global parameters; along a direction that the data leave free the
        variance is ``FREE_VARIANCE``.
    parameter_step : (m,), the Gauss-Newton step of the global parameters.
    body_response : (N, 6, m + 1), the step of the bodies is ``-(last column + rest @ step)``.
    walk_squares, walk_spread : (N - 1, 2), of the expected walk of each step, translation and
        rotation: squared length, and trace of the posterior covariance.
    score, score_information : (6,) and (6, 6), by the log variances.
    white_projected : (6, 6), the blocks of P of the observations of each pose, summed.
    sensitivity : (m, 6), derivative of the global parameters' step by the log variances.
    position_traces : tr(P R) over the translation noise of white and walk together.
    leverage : (N - 1, 2, m), of a unit of precision of each step, translation and rotation, to it.

    """

    objective: float
    covariance: FloatArray
    parameter_step: FloatArray
    body_response: FloatArray
    walk_squares: FloatArray
    walk_spread: FloatArray
    score: FloatArray
    score_information: FloatArray
    white_projected: FloatArray
    sensitivity: FloatArray
    position_traces: float
    leverage: FloatArray


def evaluate(
    chain: Chain, state: State, noise: Noise, columns: IndexArray, scale_power: float = 0.0,
) -> Evaluation:
    """Evaluate the likelihood; ``columns`` are the global parameters that are estimated.

    ``scale_power`` is the T above, half the ``position_traces`` of an evaluation nearby.

    Raises
    ------
    numpy.linalg.LinAlgError
        The normal equations are not positive definite.

    """
    return _Evaluator(chain, state, noise, columns, scale_power).run()


def objective(
    chain: Chain, state: State, noise: Noise, columns: IndexArray, scale_power: float,
) -> float:
    """Return the objective only, for half of the work; raises as ``evaluate``."""
    evaluator = _Evaluator(chain, state, noise, columns, scale_power)
    return evaluator.objective(evaluator.solve())


def predict_step(
    chain: Chain, state: State, noise: Noise, columns: IndexArray, scale_power: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the step of the parameters and the body response only: half of the work."""
    solved = _Evaluator(chain, state, noise, columns, scale_power).solve()
    return solved.step, solved.response


@dataclass(frozen=True, eq=False)
class GlobalLikelihood:
    """What the data say about all global parameters at one state, the bodies eliminated.

    Attributes
    ----------
    blocks : (BLOCKS, 12, 12), Gram matrices of the weighted equations of consecutive poses and
        steps, after the bodies have followed the parameters; the last column is the residual.
    before : (11, 11), the information of the parameters before the bodies were eliminated.
    scale_slope : what the factor ``s^T`` adds to half the gradient by the scale.

    """

    blocks: FloatArray
    before: FloatArray
    scale_slope: float

    def estimate(self, columns: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Return the step of m parameters to their minimum, the others fixed, and covariance."""
        square = np.ix_(columns, columns)
        equations = self.blocks.sum(axis=0)
        gradient = equations[columns, -1] + self.scale_slope * (
            columns == TERM_COLUMNS['scale'].start)
        covariance, free, _ = invert_information(equations[square], self.before[square])
        return -covariance @ gradient, covariance + FREE_VARIANCE * free

    def gradients(self, columns: IndexArray, step: FloatArray) -> FloatArray:
        """Return (BLOCKS, m), the part of each block in half the gradient after a step."""
        by_step = self.blocks[:, columns[:, None], columns] @ step
        total: FloatArray = self.blocks[:, columns, -1] + by_step
        return total


def global_likelihood(
    chain: Chain, state: State, noise: Noise, scale_power: float,
) -> GlobalLikelihood:
    """Eliminate the bodies from the equations of all global parameters.

    Raises
    ------
    numpy.linalg.LinAlgError
        The normal equations are not positive definite.

    """
    evaluator = _Evaluator(chain, state, noise, np.arange(PARAMETERS), scale_power)
    _, _, response, corner = evaluator.eliminate()
    return GlobalLikelihood(
        evaluator.blocks(response), corner[:-1, :-1], -scale_power / state.scale)


def invert_information(
    information: FloatArray, scale: FloatArray,
) -> tuple[FloatArray, FloatArray, float]:
    """Invert the (m, m) information where it is more than rounding.

    ``scale`` is the (m, m) information before the bodies were eliminated: its difference to what
    is left carries its rounding errors, and an eigenvalue below those is zero.

    Returns the inverse over the observed directions, the (m, m) projector on the others, and
    the logarithm of the determinant over the observed ones.
    """
    # A parameter that acts on nothing has no scale: the scale of a b that did not move.
    diagonal = np.diag(scale)
    root = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    eigenvalues, axes = np.linalg.eigh(information / np.outer(root, root))
    seen = eigenvalues > _ROUNDING
    scaled = axes / root[:, None]
    inverse = scaled[:, seen] @ (scaled[:, seen] / eigenvalues[seen]).T
    blind, _ = np.linalg.qr(scaled[:, ~seen])
    log_determinant = float(np.log(eigenvalues[seen]).sum() + 2 * np.log(root).sum())
    return inverse, blind @ blind.T, log_determinant


class _Evaluator:
    """The working arrays of one evaluation."""

    def __init__(
        self, chain: Chain, state: State, noise: Noise, columns: IndexArray, scale_power: float,
    ) -> None:
        self.scale_power = scale_power
        self.is_scale = columns == TERM_COLUMNS['scale'].start
        self.chain, self.state, self.noise, self.columns = chain, state, noise, columns
        self.m = len(columns)
        self.white_parts = noise.white_parts(state.T_a_b)
        self.white = self.white_parts.sum(axis=0)
        self.white_precision = np.linalg.inv(self.white)
        self.white_root = np.linalg.cholesky(self.white_precision).T
        self.walk_parts = noise.walk_parts()
        self.narrow = self.walk_parts.sum(axis=0)
        self.walk_precision = noise.walk_precision(self.narrow)
        self.pool = chain.pool
        self.linearised = 0
        self.all = Linearisation(self.pool.empty((len(chain), 6, 7 + self.m)),
                                 self.pool.empty((len(chain) - 1, 6, 13 + self.m)))

    def pieces(self) -> Iterator[tuple[int, Linearisation]]:
        """Yield the first pose and the linearisation of every piece."""
        for first in range(0, len(self.chain), PIECE):
            last = first + PIECE
            piece = Linearisation(self.all.observation[first:last], self.all.walk[first:last])
            if first >= self.linearised:
                linearise(self.chain, self.state, self.columns, first, last, piece)
                self.linearised = last
            yield first, piece

    def eliminate(self) -> tuple[BlockChain, FloatArray, FloatArray, FloatArray]:
        """Return the factorised chain, its border, how the bodies respond, and the corner."""
        diagonal, upper, border, corner = self.normal_equations()
        system = BlockChain.factor(diagonal, upper, self.pool)
        return system, border, system.solve(border), corner

    def solve(self) -> _Solved:
        """Solve for the global parameters, the bodies eliminated."""
        m = self.m
        system, border, response, corner = self.eliminate()
        schur = corner - gram(border, response)
        schur = 0.5 * (schur + schur.T)
        covariance, free, log_information = invert_information(schur[:m, :m], corner[:m, :m])
        gradient = schur[:m, m] - self.scale_power * self.is_scale / self.state.scale
        return _Solved(
            system, response, schur, covariance, free, log_information, -covariance @ gradient)

    def run(self) -> Evaluation:
        solved = self.solve()
        posterior = self.posterior(
            solved.system, solved.response, solved.step, solved.covariance)
        white_projected = self.white_projected(posterior)
        score, traces = self.score(posterior, white_projected)
        information, sensitivity = self.score_information(
            solved.system, solved.response, solved.covariance, posterior)
        return Evaluation(
            objective=self.objective(solved),
            covariance=solved.covariance + FREE_VARIANCE * solved.free,
            parameter_step=solved.step,
            body_response=solved.response,
            walk_squares=posterior.walk_squares,
            walk_spread=posterior.walk_spread,
            score=score,
            score_information=information,
            white_projected=white_projected,
            sensitivity=sensitivity,
            position_traces=traces,
            leverage=posterior.leverage,
        )

    def objective(self, solved: _Solved) -> float:
        """Return -2 log of the restricted likelihood, up to a constant."""
        m, schur, step = self.m, solved.schur, solved.step
        quadratic = schur[m, m] + 2 * schur[:m, m] @ step + step @ schur[:m, :m] @ step
        # In the first steps of a poor start, the scale that a step leads to may be no scale.
        scale = np.maximum(self.state.scale + step, 0.1)
        power = self.scale_power * self.is_scale
        return float(
            len(self.chain) * np.linalg.slogdet(self.white)[1]
            + self.noise.mixture_terms(self.narrow)
            + solved.system.log_determinant + solved.log_information
            + quadratic - 2 * power @ np.log(scale))

    def normal_equations(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return diagonal, upper, the border with the right-hand side, and the corner."""
        N, m = len(self.chain), self.m
        diagonal = self.pool.zeros((N, 6, 6))
        upper = self.pool.empty((N - 1, 6, 6))
        border = self.pool.zeros((N, 6, m + 1))
        corner = np.zeros((m + 1, m + 1))
        for first, piece in self.pieces():
            observation = self.white_root @ piece.observation
            poses = slice(first, first + len(observation))
            product = observation[:, :, :6].transpose(0, 2, 1) @ observation
            diagonal[poses] += product[:, :, :6]
            border[poses] += product[:, :, 6:]
            flat = observation[:, :, 6:].reshape(-1, m + 1)
            corner += flat.T @ flat
            steps = slice(first, first + len(piece.walk))
            weights = np.repeat(np.sqrt(self.walk_precision[steps]), 3, axis=1)
            walk = weights[:, :, None] * piece.walk
            product = walk[:, :, :12].transpose(0, 2, 1) @ walk
            after = slice(first + 1, first + 1 + len(walk))
            diagonal[steps] += product[:, :6, :6]
            diagonal[after] += product[:, 6:, 6:12]
            upper[steps] = product[:, :6, 6:12]
            border[steps] += product[:, :6, 12:]
            border[after] += product[:, 6:, 12:]
            flat = walk[:, :, 12:].reshape(-1, m + 1)
            corner += flat.T @ flat
        return diagonal, upper, border, corner

    def blocks(self, response: FloatArray) -> FloatArray:
        """Return (BLOCKS, m + 1, m + 1) Gram matrices of the equations without the bodies."""
        edges = np.linspace(0, len(self.chain), BLOCKS + 1).astype(np.intp)
        grams = np.zeros((BLOCKS, self.m + 1, self.m + 1))
        for first, piece in self.pieces():
            observed, walked = _followed(piece, response, first)
            observed = self.white_root @ observed
            precision = self.walk_precision[first:first + len(walked)]
            walked = np.repeat(np.sqrt(precision), 3, axis=1)[:, :, None] * walked
            local = np.clip(edges - first, 0, len(observed))
            for block, (start, end) in enumerate(pairwise(local)):
                for part in (observed[start:end], walked[start:end]):
                    grams[block] += gram(part, part)
        return grams

    def posterior(
        self, system: BlockChain, response: FloatArray, step: FloatArray, covariance: FloatArray,
    ) -> _Posterior:
        """Return the residuals at the minimum and what is known of their covariance."""
        N, m = len(self.chain), self.m
        S, C = system.partial_inverse()
        eigenvalues, axes = np.linalg.eigh(covariance)
        # Of the equations, all at once: their spread with the parameters, then the residual.
        follow = np.zeros((m + 1, m + 1))
        follow[:m, :m], follow[:, m] = axes * np.sqrt(np.maximum(eigenvalues, 0.0)), [*step, 1.0]
        observed = self.pool.empty((N, 6))
        walked = self.pool.empty((N - 1, 6))
        spread = self.pool.zeros((N - 1, 2))
        leverage = self.pool.empty((N - 1, 2, m))
        white_spread = np.zeros((6, 6))
        for first, piece in self.pieces():
            poses = slice(first, first + len(piece.observation))
            J = piece.observation[:, :, :6]
            of_poses, of_steps = _followed(piece, response, first)
            found = of_poses @ follow
            part, observed[poses] = found[:, :, :m], found[:, :, m]
            white_spread += np.einsum('kij,klj->il', J @ S[poses], J, optimize=True)
            white_spread += np.tensordot(part, part, ((0, 2), (0, 2)))
            steps = slice(first, first + len(piece.walk))
            after = slice(first + 1, first + 1 + len(piece.walk))
            K, L = piece.walk[:, :, :6], piece.walk[:, :, 6:12]
            found = of_steps @ follow
            part, walked[steps] = found[:, :, :m], found[:, :, m]
            both = K @ S[steps] + L @ (2 * C[steps]).transpose(0, 2, 1)
            for left, right in ((both, K), (L @ S[after], L), (part, part)):
                spread[steps] += _halves('kgij,kgij->kg', left, right)
            leverage[steps] = _halves('kgij,kgi->kgj', of_steps[:, :, :m], found[:, :, m])
        squares = (walked**2).reshape(-1, 2, 3).sum(axis=2)
        return _Posterior(observed, walked, squares, spread, white_spread, leverage)

    def white_projected(self, posterior: _Posterior) -> FloatArray:
        """Return the (6, 6) sum over the poses of their own blocks of P."""
        W = self.white_precision
        projected: FloatArray = len(self.chain) * W - W @ posterior.white_spread @ W
        return projected

    def score(
        self, posterior: _Posterior, white_projected: FloatArray,
    ) -> tuple[FloatArray, float]:
        """Return the (6,) score by the log variances and tr(P R) of the translations."""
        score = np.empty(len(COMPONENTS))
        weighted = posterior.observed @ self.white_precision
        energy = weighted.T @ weighted
        for i, part in enumerate(self.white_parts):
            score[i] = np.sum((white_projected - energy) * part)
        expected = posterior.walk_squares + posterior.walk_spread
        common = (1 - self.noise.jump_probability) * (3 - expected / self.narrow) / self.narrow
        score[WHITE:] = np.einsum('ckj,kj->cj', self.walk_parts, common).ravel()
        traces = np.sum(white_projected * self.white_parts[0])
        traces += np.sum(3 - posterior.walk_spread[:, 0] * self.walk_precision[:, 0])
        return score, float(traces)

    def score_information(
        self, system: BlockChain, response: FloatArray, covariance: FloatArray,
        posterior: _Posterior,
    ) -> tuple[FloatArray, FloatArray]:
        """Return the (6, 6) average information of the log variances, the (m, 6) sensitivity."""
        N, m, n = len(self.chain), self.m, len(COMPONENTS)
        weighted = posterior.observed @ self.white_precision
        # R^-1 R_i P y of the observations and of the walk.
        observed = self.pool.empty((N, 6, WHITE))
        for i, part in enumerate(self.white_parts):
            observed[:, :, i] = weighted @ part @ self.white_precision
        share = ((1 - self.noise.jump_probability) / self.narrow
                 * self.walk_parts / self.narrow)
        walked = self.pool.zeros((N - 1, 6, n - WHITE))
        for i in range(n - WHITE):
            rows = slice(3 * (i % 2), 3 * (i % 2) + 3)
            walked[:, rows, i] = share[i // 2, :, i % 2, None] * posterior.walked[:, rows]
        right = self.pool.zeros((N, 6, n))
        corner = np.zeros((m, n))
        for first, piece in self.pieces():
            poses = slice(first, first + len(piece.observation))
            product = piece.observation[:, :, :6].transpose(0, 2, 1) @ observed[poses]
            right[poses, :, :WHITE] += product
            corner[:, :WHITE] += gram(piece.observation[:, :, 6:6 + m], observed[poses])
            steps = slice(first, first + len(piece.walk))
            product = piece.walk[:, :, :12].transpose(0, 2, 1) @ walked[steps]
            right[steps, :, WHITE:] += product[:, :6]
            right[first + 1:first + 1 + len(piece.walk), :, WHITE:] += product[:, 6:]
            corner[:, WHITE:] += gram(piece.walk[:, :, 12:12 + m], walked[steps])
        corner -= gram(response, right)[:m]
        total = -system.quadratic_form(right) - corner.T @ covariance @ corner
        total[:WHITE, :WHITE] += gram(observed, self.white @ observed)
        variance = np.repeat(1 / self.walk_precision, 3, axis=1)[:, :, None]
        total[WHITE:, WHITE:] += gram(walked, variance * walked)
        # With G^T V^-1 (r + G g) = 0, V of the bodies eliminated: dg = cov G^T V^-1 R_i P y.
        return 0.25 * (total + total.T), covariance @ corner


@dataclass(frozen=True, eq=False)
class _Solved:
    """The factorised chain, its response, and the global parameters' equations."""

    system: BlockChain
    response: FloatArray
    schur: FloatArray
    covariance: FloatArray
    free: FloatArray
    log_information: float
    step: FloatArray


@dataclass(frozen=True, eq=False)
class _Posterior:
    """Residuals at the minimum: observations (N, 6), walk (N - 1, 6), and their spread."""

    observed: FloatArray
    walked: FloatArray
    walk_squares: FloatArray
    walk_spread: FloatArray
    white_spread: FloatArray
    leverage: FloatArray


def _followed(
    piece: Linearisation, response: FloatArray, first: int,
) -> tuple[FloatArray, FloatArray]:
    """Return the equations (n, 6, m + 1) of poses and of steps after the bodies have followed.

    ``first`` is the first pose of the piece in the (N, 6, m + 1) ``response``.
    """
    bodies = response[first:first + len(piece.observation)]
    observed = piece.observation[:, :, 6:] - piece.observation[:, :, :6] @ bodies
    # The rows of both ends of a step follow each other: (N - 1, 12, m + 1) without a copy.
    rows = response.reshape(-1, response.shape[2])
    ends = sliding_window_view(rows, 12, axis=0)[::6].transpose(0, 2, 1)
    steps = slice(first, first + len(piece.walk))
    return observed, piece.walk[:, :, 12:] - piece.walk[:, :, :12] @ ends[steps]


def _halves(subscripts: str, left: FloatArray, right: FloatArray) -> FloatArray:
    """Sum products of two (N, 6, ...) as ``subscripts`` says, g translation or rotation."""
    apart = (values.reshape(len(values), 2, 3, *values.shape[2:]) for values in (left, right))
    return np.einsum(subscripts, *apart)
