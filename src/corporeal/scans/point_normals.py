"""Normals of point clouds: planes through neighbours, turned outward together."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Float64, Int
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

NEIGHBOURS = 12


def point_normals(
    points: Float[np.ndarray, "N 3"], neighbours: int = NEIGHBOURS
) -> Float64[np.ndarray, "N 3"]:
    """Outward unit normals of points that were sampled from a surface.

    The direction is that of least variance among the nearest neighbours. Signs are passed along the minimum
    spanning tree of the neighbour graph (Hoppe et al. 1992, section 3.3), with the rule of König and Gumhold
    2009: a normal is compared with the neighbour's *reflected* at the plane between the two. Hoppe's own rule
    takes two fingers that touch for one sheet and turns one of them inside out; the reflection tells opposite
    sheets from a continued one. Every connected part then takes the sign that makes the volume which it
    encloses positive, which is exact for a closed surface and a good guess for an open one.

    Args:
        points: (N, 3) any unit; finite, no two equal; N > neighbours.
        neighbours: how many neighbours span a plane.

    Raises:
        ValueError: there are not more points than neighbours.
    """
    if len(points) <= neighbours:
        raise ValueError(f"points: expected more than {neighbours}, got {len(points)}")
    distances, nearest = cKDTree(points).query(points, k=neighbours + 1, workers=-1)
    normals = _least_variance(points, nearest)
    edges = np.stack([np.repeat(np.arange(len(points)), neighbours), nearest[:, 1:].ravel()], axis=1)
    agreement = _reflected_agreement(points, normals, edges)
    signs = _propagated_signs(len(points), edges, agreement)
    normals *= signs[:, None]
    # Areas that points stand for, so that a densely scanned side does not outvote the other.
    areas = distances[:, -1] ** 2
    return normals * _outward(points, normals, areas, edges)[:, None]


def _least_variance(points: np.ndarray, nearest: np.ndarray) -> np.ndarray:
    patches = points[nearest]
    patches = patches - patches.mean(axis=1, keepdims=True)
    _, vectors = np.linalg.eigh(np.einsum("nki,nkj->nij", patches, patches))
    return np.ascontiguousarray(vectors[:, :, 0])


def _reflected_agreement(
    points: np.ndarray, normals: np.ndarray, edges: Int[np.ndarray, "E 2"]
) -> Float[np.ndarray, " E"]:
    """Cosine between the normals of an edge, one of them reflected at the plane that halves the edge."""
    first, second = normals[edges[:, 0]], normals[edges[:, 1]]
    along = points[edges[:, 1]] - points[edges[:, 0]]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across_first, across_second = (np.einsum("ei,ei->e", n, along) for n in (first, second))
    return np.einsum("ei,ei->e", first, second) - 2 * across_first * across_second


def _propagated_signs(count: int, edges: np.ndarray, agreement: np.ndarray) -> Float[np.ndarray, " N"]:
    # scipy takes a weight of 0 for no edge: hence the small offset.
    doubt = 1 - np.abs(agreement) + 1e-6
    low, high = edges.min(axis=1), edges.max(axis=1)
    unique, index = np.unique(low * count + high, return_index=True)
    graph = sp.csr_matrix((doubt[index], (unique // count, unique % count)), shape=(count, count))
    tree = csgraph.minimum_spanning_tree(graph).tocoo()
    flips = np.sign(agreement[index])[np.searchsorted(unique, tree.row.astype(np.int64) * count + tree.col)]
    return _signs_from_roots(count, tree.row, tree.col, flips)


def _signs_from_roots(
    count: int, row: np.ndarray, column: np.ndarray, flips: np.ndarray
) -> Float[np.ndarray, " N"]:
    """Signs along a forest whose edges say whether their ends agree.

    Every point has two copies, one per sign; an edge joins the copies that go together. Copies that are
    connected with the first point of their tree's positive copy tell the signs, without a loop in Python.
    """
    opposite = np.where(flips < 0, count, 0)
    ends = np.concatenate([column + opposite, column + count - opposite])
    begins = np.concatenate([row, row + count])
    graph = sp.coo_matrix((np.ones(len(begins)), (begins, ends)), shape=(2 * count, 2 * count))
    _, labels = csgraph.connected_components(graph, directed=False)
    # A tree's copies are two components; that of its first point's positive copy is met, and labelled, first.
    return np.where(labels[:count] < labels[count:], 1.0, -1.0)


def _outward(points: np.ndarray, normals: np.ndarray, areas: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """+1 or -1 per point, the same in every connected part: the sign of the part's volume."""
    count = len(points)
    graph = sp.coo_matrix((np.ones(len(edges)), edges.T), shape=(count, count))
    parts, labels = csgraph.connected_components(graph, directed=False)
    mass = np.bincount(labels, areas, minlength=parts)
    centres = np.stack([np.bincount(labels, areas * points[:, i], minlength=parts) for i in range(3)], axis=1)
    centres /= np.where(mass > 0, mass, 1)[:, None]
    flux = areas * np.einsum("ni,ni->n", normals, points - centres[labels])
    return np.where(np.bincount(labels, flux, minlength=parts) < 0, -1.0, 1.0)[labels]
