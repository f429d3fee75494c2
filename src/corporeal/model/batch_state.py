"""What the kernels of posing keep of a batch and hand on; named tuples, because numba takes them whole."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float


class Parameters(NamedTuple):
    """What a batch is posed by; ``axis_angle`` is empty where the pose came as matrices."""

    axis_angle: Float[np.ndarray, "b K 3"]
    coefficients: Float[np.ndarray, "B C"]
    translation: Float[np.ndarray, "B 3"]


class BatchState(NamedTuple):
    """What the kernels keep of a batch, for the backward pass too; Bp is B, padded to whole lanes."""

    row: Float[np.ndarray, "Bp N"]  # 1, coefficients, pose feature: the rest surface is basis @ row
    local: Float[np.ndarray, "Bp K 3 3"]
    rest_joints: Float[np.ndarray, "Bp K 3"]
    motion: Float[np.ndarray, "Bp K 12"]
    joints: Float[np.ndarray, "B K 3"]
    T: Float[np.ndarray, "B K 4 4"]


class Skinned(NamedTuple):
    """What skinning a few surfaces leaves for the way back."""

    rest: Float[np.ndarray, "B V3"]
    blended: Float[np.ndarray, "B V 12"]  # the motion of every vertex


class Band(NamedTuple):
    """The vertices ``first`` to ``last`` of a large batch, few enough that their rest surface is cached."""

    first: int
    last: int
    rest: Float[np.ndarray, "V3 Bp"]  # of these vertices only


class BandGradients(NamedTuple):
    """What the way back of a band reads, adds to and writes."""

    vertices: Float[np.ndarray, "B V 3"]  # of all vertices
    motion: Float[np.ndarray, "s b K L"]  # added to, by each split of the vertices apart
    rest: Float[np.ndarray, "V3 Bp"]


class OutputGradients(NamedTuple):
    """Gradients by what posing returns; empty where there are none."""

    vertices: Float[np.ndarray, "a V 3"]
    joints: Float[np.ndarray, "b K 3"]
    T: Float[np.ndarray, "c K 4 4"]


class SkinGradients(NamedTuple):
    """Gradients by what skinning used; that by the row in parts that were summed by different threads."""

    motion: Float[np.ndarray, "B K 12"]
    row: Float[np.ndarray, "c B N"]


class Incoming(NamedTuple):
    """Gradients that the tree passes on; those by joints and frames are empty where there are none."""

    motion: Float[np.ndarray, "Bp K 12"]
    row: Float[np.ndarray, "Bp N"]
    joints: Float[np.ndarray, "b K 3"]
    T: Float[np.ndarray, "c K 4 4"]


class ParameterGradients(NamedTuple):
    """Gradients by the parameters."""

    coefficients: Float[np.ndarray, "B C"]
    local: Float[np.ndarray, "B K 3 3"]
    axis_angle: Float[np.ndarray, "b K 3"]
    translation: Float[np.ndarray, "B 3"]
