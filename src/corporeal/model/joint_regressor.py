"""Joints of a surface: regressors, non-negative and sparse, rows that sum to one; what hangs below."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.optimize import nnls

from corporeal.model.surface_model import CutPlane, SurfaceModel

# Vertices farther from a joint than this, in its mean distance to the nearest tenth of the candidates, are no
# candidates.
_REACH = 3.0
_FEWEST = 40
# Weight of "the row sums to one" against metres: its miss after division by the sum is then below a
# micrometre.
_SUM = 10.0
# Hold of the start model's row, metres per unit of weight. With fewer people than vertices many rows give the
# same joints; without it (2e-4) four to fourteen vertices on one side of a finger stood for its joint, and
# other people's joints were wrong.
_HOLD = 0.01
# A vertex that bears less of its joint than this part of what the foremost bears is left out, and the others
# are solved for again.
_LEAST = 0.02
# Square metres: rows that miss their joints by less, by rounding, stay.
_EXACT = 1e-18


def fit_regressor(
    templates: Float[np.ndarray, "H V 3"],
    joints: Float[np.ndarray, "H K 3"],
    old: sp.csr_matrix,
    most: int | None = None,
) -> sp.csr_matrix:
    """Rows that give every subject's joints from its template, by non-negative least squares.

    A row replaces the old one only where it gives the joints better.

    Args:
        templates: of every subject, metres.
        joints: of every subject, metres.
        old: rows of before.
        most: candidates for a row beside those of the old one, evenly from all; None for all. Deep in a body
            they are thousands, and solving for them takes seconds.
    """
    rows = []
    for joint in range(joints.shape[1]):
        before = old[joint].toarray()[0]
        missed = _miss(templates, joints[:, joint], before)
        row = before if missed < _EXACT else _row(templates, joints[:, joint], before, most)
        rows.append(row if _miss(templates, joints[:, joint], row) < missed else before)
    return sp.csr_matrix(np.array(rows))


def _row(
    templates: Float[np.ndarray, "H V 3"], joints: Float[np.ndarray, "H 3"], before: Float[np.ndarray, " V"],
    most: int | None,
) -> Float[np.ndarray, " V"]:  # fmt: skip
    """A joint's row, without vertices that bear next to nothing of it."""
    used = _candidates(templates.mean(axis=0), joints.mean(axis=0), before)
    if most is not None:
        others = used[before[used] == 0]
        even = np.linspace(0, len(others) - 1, min(most, len(others))).astype(int)
        used = np.union1d(used[before[used] > 0], others[even])
    shares = _shares(templates[:, used], joints, before[used])
    while (kept := shares >= _LEAST * shares.max()).sum() < len(used):
        used = used[kept]
        shares = _shares(templates[:, used], joints, before[used])
    row = np.zeros(templates.shape[1])
    row[used] = shares
    return row


def _shares(
    places: Float[np.ndarray, "H n 3"], joints: Float[np.ndarray, "H 3"], before: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """Shares of a joint, summing to one, by non-negative least squares."""
    # Relative to the joint, so that the sum of one is no part of the fit.
    arms = (places - joints[:, None]).transpose(0, 2, 1).reshape(-1, len(before))
    equations = np.vstack([arms, _SUM * np.ones((1, len(before))), _HOLD * np.eye(len(before))])
    wanted = np.concatenate([np.zeros(len(arms)), [_SUM], _HOLD * before])
    solved, _ = nnls(equations, wanted)
    return solved / solved.sum()


def _candidates(
    template: Float[np.ndarray, "V 3"], joint: Float[np.ndarray, "3"], before: Float[np.ndarray, " V"]
) -> Int[np.ndarray, " n"]:
    """Vertices around a joint: those of the old row, and all within reach."""
    distances = np.linalg.norm(template - joint, axis=1)
    nearest = np.sort(distances)[: max(_FEWEST, 1)]
    reach = _REACH * float(nearest.mean())
    return np.flatnonzero((before > 0) | (distances < reach))


def _miss(
    templates: Float[np.ndarray, "H V 3"], joints: Float[np.ndarray, "H 3"], row: Float[np.ndarray, " V"]
) -> float:
    return float(np.square(np.einsum("v,hva->ha", row, templates) - joints).sum())


def joints_below(parents: Int[np.ndarray, " K"]) -> Float[np.ndarray, "K K"]:
    """1 where the row's joint is the column's or hangs below it: weights @ this is what a joint carries."""
    below = np.eye(len(parents))
    for joint in range(len(parents) - 1, 0, -1):
        below[:, parents[joint]] += below[:, joint]
    return below


def same_cut(start: SurfaceModel, joints: Float[np.ndarray, "K 3"]) -> CutPlane | None:
    """The same plane of the surface, seen from a joint that may have moved."""
    if start.cut is None:
        return None
    before = (start.joint_regressor @ start.template)[start.cut.joint]
    return CutPlane(start.cut.joint, start.cut.point + before - joints[start.cut.joint], start.cut.normal)


def with_regressor(model: SurfaceModel, regressor: sp.csr_matrix) -> SurfaceModel:
    """The model with other joints; it ends at the same plane of its surface."""
    return model.replace(joint_regressor=regressor, cut=same_cut(model, regressor @ model.template))
