"""The shape space: PCA over identities, each given smooth variation that the generator does not know.

The generator's hands are nearly seven-dimensional: long fingers are long together. Real ones are not, so
every sample also gets its own finger lengths and girths, its own palm, and smooth bumps of a millimetre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from .rig import FINGERS, PosedHand

# Standard deviations: of lengths and girths as shares, of bumps in metres.
_FINGER_LENGTH, _FINGER_GIRTH = 0.045, 0.06
_PALM = {"length": 0.03, "width": 0.04, "thickness": 0.06}
_BUMP, _BUMP_MODES = 1.2e-3, 12


@dataclass(frozen=True, eq=False)
class ShapeSpace:
    """Template (V, 3), directions (V, 3, S) of unit variance, and the share of variance of each."""

    template: np.ndarray
    directions: np.ndarray
    shares: np.ndarray


def learn_shape_space(
    hands: list[PosedHand], faces: np.ndarray, weights: np.ndarray, count: int, seed: int
) -> ShapeSpace:
    """PCA of identities plus variation, about the mean identity, aligned at the wrist."""
    generator = np.random.default_rng(seed)
    people = np.array([hand.vertices - hand.joints[0] for hand in hands])
    template = people.mean(0)
    fields = variation_fields(template, np.mean([hand.joints for hand in hands], axis=0), faces, weights)
    draws = np.repeat(np.arange(len(people)), 8)
    samples = (
        people[draws] - template + np.tensordot(generator.normal(size=(len(draws), len(fields))), fields, 1)
    )
    flat = samples.reshape(len(samples), -1)
    flat = flat - flat.mean(0)
    _, s, vt = np.linalg.svd(flat, full_matrices=False)
    deviations = s / np.sqrt(len(flat) - 1)
    signs = np.sign(vt[np.arange(count), np.abs(vt[:count]).argmax(1)])  # the same on every machine
    directions = (signs * deviations[:count])[:, None] * vt[:count]
    shares = deviations**2 / np.sum(deviations**2)
    return ShapeSpace(template, directions.reshape(count, -1, 3).transpose(1, 2, 0), shares[:count])


def variation_fields(
    template: np.ndarray, joints: np.ndarray, faces: np.ndarray, weights: np.ndarray
) -> np.ndarray:
    """Displacements (N, V, 3) in metres for one standard deviation of each variation."""
    fields = []
    for f in range(len(FINGERS)):
        fields += _finger_fields(template, joints, weights, f)
    palm = weights[:, :1]
    for axis, name in enumerate(("length", "thickness", "width")):
        stretch = np.zeros(3)
        stretch[axis] = _PALM[name]
        # Fingers are carried along with their knuckles, not stretched with the palm.
        carried = sum(
            weights[:, 3 * f + 1 : 3 * f + 4].sum(1, keepdims=True) * joints[3 * f + 1] * stretch
            for f in range(5)
        )
        fields.append(palm * template * stretch + carried)
    return np.concatenate([np.array(fields), _bumps(template, faces)])


def _finger_fields(template: np.ndarray, joints: np.ndarray, weights: np.ndarray, f: int) -> list[np.ndarray]:
    first = 3 * f + 1
    own = weights[:, first : first + 3].sum(1, keepdims=True)
    base = joints[first]
    axis = joints[first + 2] - base
    axis /= np.linalg.norm(axis)
    along = np.maximum((template - base) @ axis, 0)[:, None]
    centre = base + ((template - base) @ axis)[:, None] * axis
    # Girth grows in over the first centimetre, so that the finger's root stays on the palm.
    grown = own * np.clip(along / 0.01, 0, 1)
    length = own * along * axis * _FINGER_LENGTH
    return [length, grown * (template - centre) * _FINGER_GIRTH]


def _bumps(template: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The smoothest functions on the mesh (eigenvectors of its Laplacian), along each axis."""
    edges = np.unique(
        np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), 1), axis=0
    )
    lengths = np.linalg.norm(template[edges[:, 0]] - template[edges[:, 1]], axis=1)
    n = len(template)
    W = sp.coo_matrix((lengths.mean() / lengths, (edges[:, 0], edges[:, 1])), shape=(n, n))
    W = (W + W.T).tocsr()
    laplacian = sp.diags(np.asarray(W.sum(1)).ravel()) - W
    start = np.random.default_rng(0).normal(size=n)
    _, modes = spl.eigsh(laplacian.tocsc(), k=_BUMP_MODES + 1, sigma=-1e-3, v0=start)
    modes = modes[:, 1:] if np.ptp(modes[:, 0]) < 1e-6 else modes[:, :_BUMP_MODES]
    modes = modes / modes.std(0)
    fields = np.zeros((3 * modes.shape[1], n, 3))
    for k in range(modes.shape[1]):
        for axis in range(3):
            fields[3 * k + axis, :, axis] = _BUMP / np.sqrt(1 + k) * modes[:, k]
    return fields
