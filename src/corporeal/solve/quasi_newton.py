"""Limited-memory BFGS with a preconditioner: for energies whose Hessian is too dear to factorise.

Liu, Bouaziz and Kavan 2017, "Quasi-Newton methods for real-time simulation of hyperelastic materials": a
constant matrix factorised once stands in for the first inverse Hessian, the last few steps correct it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

EnergyAndGradient = Callable[[np.ndarray], tuple[float, np.ndarray]]
_SUFFICIENT = 1e-4


@dataclass(frozen=True)
class QuasiNewtonOptions:
    """When to stop.

    Attributes:
        iterations: most steps.
        tolerance: the largest component of a step, in the unit of the unknowns, below which it has settled.
        memory: pairs kept.
        refresh_every: steps after which ``refresh`` is asked to renew what the energy holds fixed.
    """

    iterations: int = 200
    tolerance: float = 1e-3
    memory: int = 8
    refresh_every: int = 8


@dataclass(frozen=True, eq=False)
class Settled:
    """Where the descent ended: unknowns (n, 3), energy, steps taken, and whether the tolerance was met."""

    x: Float[np.ndarray, "n 3"]
    energy: float
    iterations: int
    converged: bool


def descend(
    energy: EnergyAndGradient,
    start: Float[np.ndarray, "n 3"],
    precondition: Callable[[np.ndarray], np.ndarray],
    options: QuasiNewtonOptions,
    refresh: Callable[[np.ndarray], bool] | None = None,
) -> Settled:
    """Minimise an energy of points.

    Args:
        energy: value and gradient (n, 3) at points.
        start: where to begin.
        precondition: gradient (n, 3) -> step-like (n, 3); symmetric positive definite.
        options: when to stop.
        refresh: called with the points now and then; true when the energy changed, which ends no descent.
    """
    x = start.copy()
    value, gradient = energy(x)
    pairs: deque[tuple[np.ndarray, np.ndarray, float]] = deque(maxlen=options.memory)
    quiet, taken = 0, 0
    for taken in range(1, options.iterations + 1):
        direction = -_two_loops(gradient, pairs, precondition)
        slope = float(np.vdot(gradient, direction))
        if not slope < 0:
            pairs.clear()
            direction = -precondition(gradient)
            slope = float(np.vdot(gradient, direction))
        step, trial, trial_value, trial_gradient = _line_search(energy, x, value, direction, slope)
        if step == 0.0:
            if not pairs:
                break
            pairs.clear()
            continue
        moved, changed = trial - x, trial_gradient - gradient
        curvature = float(np.vdot(moved, changed))
        if curvature > 1e-12 * np.linalg.norm(moved) * np.linalg.norm(changed):
            pairs.append((moved, changed, curvature))
        x, value, gradient = trial, trial_value, trial_gradient
        quiet = quiet + 1 if np.abs(moved).max() < options.tolerance else 0
        renewed = taken % options.refresh_every == 0 and refresh is not None and refresh(x)
        if renewed:
            value, gradient = energy(x)
        if quiet >= 3:
            return Settled(x, value, taken, True)
    return Settled(x, value, taken, quiet >= 3)


def _two_loops(
    gradient: np.ndarray, pairs: deque, precondition: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """The inverse Hessian's product with the gradient (Nocedal and Wright 2006, algorithm 7.4)."""
    q = gradient.copy()
    shares = []
    for moved, changed, curvature in reversed(pairs):
        share = float(np.vdot(moved, q)) / curvature
        q -= share * changed
        shares.append(share)
    r = precondition(q)
    for (moved, changed, curvature), share in zip(pairs, reversed(shares), strict=True):
        r += (share - float(np.vdot(changed, r)) / curvature) * moved
    return r


def _line_search(
    energy: EnergyAndGradient, x: np.ndarray, value: float, direction: np.ndarray, slope: float
) -> tuple[float, np.ndarray, float, np.ndarray]:
    """Halve the step until the energy falls enough; a step of zero where it never does."""
    step = 1.0
    for _ in range(14):
        trial = x + step * direction
        trial_value, trial_gradient = energy(trial)
        if trial_value <= value + _SUFFICIENT * step * slope:
            return step, trial, trial_value, trial_gradient
        step *= 0.5
    return 0.0, x, value, np.zeros_like(x)
