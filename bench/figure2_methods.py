"""The identification methods that `figure2.py` compares, each a function from a `Problem` to an `Answer`.

All that fit parameters get the same 18 parameters a joint, the same data, the same nominal values and the same box
around them, and one generator of chance. What the paper does not say of a method is set here, once, as a constant.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from spacearm_ident.arrays import FloatArray
from spacearm_ident.dynamics.model import TorqueModel
from spacearm_ident.estimate.consistency import make_consistent
from spacearm_ident.identification.fit import reweighted, searched
from spacearm_ident.noise.weights import reweight
from spacearm_ident.regression.prior import Prior
from spacearm_ident.regression.regression import Regression
from spacearm_ident.signals.motion import Motion
from spacearm_ident.solvers import pso, pso_lm, separable
from spacearm_ident.solvers.separable import Solution
from spacearm_ident.solvers.solution_columns import residuals_of
from spacearm_ident.solvers.swarm_cost import SwarmCost, Unknowns

GENERATIONS, TOURNAMENT, BLEND, MUTATION = 300, 3, 0.5, 0.02
"""Genetic algorithm: as many evaluations as the swarm's; BLX-0.5 crossover, one gene in fifty mutated."""
HIDDEN, EPOCHS = (100, 100), 500
"""Neural network: two hidden layers, Adam, over standardised q, qd, qdd."""
REWEIGHTINGS = 2


@dataclass(frozen=True)
class Problem:
    """What every method is given.

    Attributes:
        model: The paper's structure.
        motion: Excitation, with measured torque.
        parameters, constants: Nominal values.
        reach, ratio: The box: nominal +- `reach` (p,), and nominal constants times 1/ratio..ratio.
        sigma: (n,) standard deviation of the noise, N·m (the Kalman filter is told).
        rng: Source of chance.
    """

    model: TorqueModel
    motion: Motion
    parameters: FloatArray
    constants: FloatArray
    reach: FloatArray
    ratio: float
    sigma: FloatArray
    rng: np.random.Generator

    def regression(self) -> Regression:
        """Columns and torque, every row of weight one."""
        return Regression(self.model, [self.motion])

    @property
    def prior(self) -> Prior:
        """Nominal values, as uncertain as the box is wide; the methods without a prior take only its numbering."""
        rows = np.diag(1.0 / self.reach)
        return Prior(rows, self.parameters / self.reach, self.reach, self.parameters, np.arange(len(self.reach)))

    @property
    def unknowns(self) -> Unknowns:
        """All 108 in one vector; d_s is not among them."""
        searched = [k for k, constant in enumerate(self.model.constants) if constant.symbol == "v_b"]
        return Unknowns(np.arange(len(self.reach)), np.array(searched), self.parameters, len(self.constants))

    def point(self) -> FloatArray:
        """The nominal values as that vector."""
        return np.concatenate([self.parameters, self.constants[self.unknowns.searched]])

    def box(self) -> tuple[FloatArray, FloatArray]:
        """(108,) lower and upper."""
        speeds = self.constants[self.unknowns.searched]
        return (
            np.concatenate([self.parameters - self.reach, speeds / self.ratio]),
            np.concatenate([self.parameters + self.reach, speeds * self.ratio]),
        )

    def walls(self) -> tuple[FloatArray, FloatArray]:
        """The box of the Stribeck velocities only."""
        lower, upper = self.box()
        lower[: len(self.reach)], upper[: len(self.reach)] = -np.inf, np.inf
        return lower, upper


@dataclass(frozen=True)
class Answer:
    """Parameters and constants, or, where a method has none, only a predictor of torque along a motion."""

    parameters: FloatArray | None = None
    constants: FloatArray | None = None
    predict: Callable[[Motion], FloatArray] | None = None
    note: str = ""


def _answer(problem: Problem, point: FloatArray, note: str = "") -> Answer:
    parameters, constants = problem.unknowns.split(point)
    return Answer(parameters, constants, note=note)


def lm(problem: Problem) -> Answer:
    """Levenberg-Marquardt of the paper over all 108, from the nominal values."""
    linearise = pso_lm.linearised(problem.regression(), problem.unknowns)
    found = pso_lm.refine(linearise, problem.point(), None, *problem.walls())
    return _answer(problem, found.point, found.status)


def lm_from_anywhere(problem: Problem) -> Answer:
    """The same from a random place in the box: what the swarm saves LM from, by the paper."""
    linearise = pso_lm.linearised(problem.regression(), problem.unknowns)
    found = pso_lm.refine(linearise, problem.rng.uniform(*problem.box()), None, *problem.walls())
    return _answer(problem, found.point, found.status)


def swarm(problem: Problem) -> Answer:
    """Particle swarm of the paper over all 108: its stage 1 alone."""
    cost = SwarmCost(problem.regression(), problem.unknowns, *problem.box())
    return _answer(problem, pso.minimise(cost, *problem.box(), problem.rng).best)


def swarm_lm(problem: Problem) -> Answer:
    """PSO-LM as published."""
    regression = problem.regression()
    cost = SwarmCost(regression, problem.unknowns, *problem.box())
    linearise = pso_lm.linearised(regression, problem.unknowns)
    found = pso_lm.minimise(cost, linearise, *problem.box(), problem.rng, walls=problem.walls())
    return _answer(problem, found.point, f"{len(found.rounds)} rounds, {found.rounds[-1].refined.status}")


def weighted_least_squares(problem: Problem) -> Answer:
    """Linear least squares at the nominal Stribeck velocities, joints weighted by their residual."""
    regression = problem.regression()
    for _ in range(REWEIGHTINGS + 1):
        parameters, cost = separable.solve_linear(regression, problem.prior, problem.constants)
        reweight(regression, residuals_of(regression, Solution(parameters, problem.constants, cost, 0, "")))
    return Answer(parameters, problem.constants)


def ours(problem: Problem) -> Answer:
    """What `spacearm identify` does by default, but for a choice of structure: separable, reweighted, consistent."""
    regression, prior = problem.regression(), problem.prior
    first = searched(regression, prior)
    solution, _ = reweighted(regression, prior, first)
    matrix, _ = separable.system(regression, prior, solution.constants)
    consistent = make_consistent(problem.model, matrix, solution.parameters, prior.scale)
    return Answer(consistent, solution.constants, note=solution.status)


def genetic(problem: Problem) -> Answer:
    """A real-coded genetic algorithm: tournament, blend crossover, mutation, the best is kept."""
    rng, (lower, upper) = problem.rng, problem.box()
    cost = SwarmCost(problem.regression(), problem.unknowns, lower, upper)
    people = rng.uniform(lower, upper, (100, len(lower)))
    fitness = cost(people)
    for generation in range(GENERATIONS):
        entrants = rng.integers(len(people), size=(2, len(people), TOURNAMENT))
        winners = np.take_along_axis(entrants, fitness[entrants].argmin(axis=2)[..., None], axis=2)[..., 0]
        mother, father = people[winners[0]], people[winners[1]]
        children = mother + rng.uniform(-BLEND, 1 + BLEND, mother.shape) * (father - mother)
        spread = 0.2 * (1 - generation / GENERATIONS) * (upper - lower)
        children += (rng.random(children.shape) < MUTATION) * spread * rng.standard_normal(children.shape)
        children = np.clip(children, lower, upper)
        children[0] = people[fitness.argmin()]
        people, fitness = children, cost(children)
    return _answer(problem, people[fitness.argmin()])


def kalman(problem: Problem) -> Answer:
    """An extended Kalman filter over all 108, in one pass over the samples; its spread at first is the box."""
    motion, unknowns, (lower, upper) = problem.motion, problem.unknowns, problem.walls()
    columns = _columns_of_samples(problem)
    velocity, count = motion.velocity, len(problem.parameters)
    coulomb = np.array([_number(problem.model, "f_c", joint) for joint in motion.joints])
    static = np.array([_number(problem.model, "f_b", joint) for joint in motion.joints])
    speeds = count + np.arange(len(unknowns.searched))
    rows = np.arange(len(motion.joints))
    state = problem.point()
    box = problem.box()
    covariance = np.diag(((box[1] - box[0]) / 2 / np.sqrt(3)) ** 2)
    noise = np.diag(problem.sigma**2)
    for sample, (speed, torque) in enumerate(zip(velocity, motion.torque)):
        ratio = speed / state[speeds]
        share = np.sign(speed) * np.exp(-(ratio**2))
        jacobian = np.zeros((len(rows), len(state)))
        jacobian[:, :count] = columns[sample]
        jacobian[rows, coulomb], jacobian[rows, static] = np.sign(speed) - share, share
        predicted = jacobian[:, :count] @ state[:count]
        jacobian[rows, speeds] = (state[static] - state[coulomb]) * share * 2 * ratio**2 / state[speeds]
        gain = np.linalg.solve(jacobian @ covariance @ jacobian.T + noise, jacobian @ covariance).T
        state = np.clip(state + gain @ (torque - predicted), lower, upper)
        covariance -= gain @ jacobian @ covariance
        covariance = (covariance + covariance.T) / 2
    return _answer(problem, state)


def _number(model: TorqueModel, symbol: str, joint: str) -> int:
    return next(k for k, item in enumerate(model.parameters) if item.name == f"{symbol}[{joint}]")


def _columns_of_samples(problem: Problem) -> FloatArray:
    """(N, n, p) columns of all terms at the nominal constants, sample by sample."""
    motion, model = problem.motion, problem.model
    columns = np.zeros((len(motion.position), len(motion.joints), len(model.parameters)))
    for term, first, first_constant in model.numbered():
        values = problem.constants[first_constant : first_constant + len(term.constants)]
        for row, (indices, block) in term.columns(motion, values, None).items():
            columns[:, row, first + np.array(indices)] = block
    return columns


def network(problem: Problem) -> Answer:
    """A multilayer perceptron from q, qd, qdd to the torques.

    Raises:
        ImportError: scikit-learn is not installed.
    """
    from sklearn.neural_network import MLPRegressor
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    def features(motion: Motion) -> FloatArray:
        return np.column_stack([motion.position, motion.velocity, motion.acceleration])

    measured = problem.motion.torque
    size = measured.std(axis=0)
    seed = int(problem.rng.integers(2**31))
    regressor = MLPRegressor(hidden_layer_sizes=HIDDEN, max_iter=EPOCHS, random_state=seed, n_iter_no_change=EPOCHS)
    machine = make_pipeline(StandardScaler(), regressor)
    machine.fit(features(problem.motion), measured / size)
    return Answer(predict=lambda motion: np.asarray(machine.predict(features(motion))) * size)


METHODS: dict[str, Callable[[Problem], Answer]] = {
    "LM": lm,
    "LM, random start": lm_from_anywhere,
    "PSO": swarm,
    "PSO-LM": swarm_lm,
    "WLS, fixed v_b": weighted_least_squares,
    "neural network": network,
    "genetic algorithm": genetic,
    "Kalman filter": kalman,
    "separable (ours)": ours,
}
