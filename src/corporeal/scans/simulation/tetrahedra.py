"""Tetrahedral meshes; elements are positive where corners 1, 2, 3 stand right-handed on corner 0."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int
from scipy.spatial import cKDTree

_CANDIDATES = 24


def edge_matrices(
    vertices: Float[np.ndarray, "T 3"], tets: Int[np.ndarray, "M 4"]
) -> Float[np.ndarray, "M 3 3"]:
    """Columns: corners 1, 2 and 3 seen from corner 0; the determinant is six times the volume."""
    corners = vertices[tets]
    return (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)


def laplacian(vertices: Float[np.ndarray, "T 3"], tets: Int[np.ndarray, "M 4"]) -> sp.csr_matrix:
    """(T, T) stiffness of linear elements: x' L x is the integral of the squared gradient."""
    edges = edge_matrices(vertices, tets)
    inverse = np.linalg.inv(edges)
    gradients = np.concatenate([-inverse.sum(1, keepdims=True), inverse], axis=1)
    local = np.einsum("eia,eja,e->eij", gradients, gradients, np.linalg.det(edges) / 6)
    rows, columns = np.repeat(tets, 4, axis=1).ravel(), np.tile(tets, (1, 4)).ravel()
    return sp.csr_matrix((local.ravel(), (rows, columns)), shape=(len(vertices),) * 2)


def places(
    points: Float[np.ndarray, "n 3"], vertices: Float[np.ndarray, "T 3"], tets: Int[np.ndarray, "M 4"]
) -> tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 4"]]:
    """The tetrahedron that every point lies in (or least outside), and its barycentric weights there."""
    corners = vertices[tets]
    _, near = cKDTree(corners.mean(1)).query(points, k=min(_CANDIDATES, len(tets)))
    inverse = np.linalg.inv(edge_matrices(vertices, tets))
    others = np.einsum("nkab,nkb->nka", inverse[near], points[:, None] - corners[near, 0])
    shares = np.concatenate([1 - others.sum(-1, keepdims=True), others], axis=-1)
    best, rows = shares.min(-1).argmax(1), np.arange(len(points))
    return near[rows, best], shares[rows, best]


def vertex_gradients(
    rest: Float[np.ndarray, "T 3"], posed: Float[np.ndarray, "T 3"], tets: Int[np.ndarray, "M 4"]
) -> Float[np.ndarray, "T 3 3"]:
    """Deformation gradients of vertices: the volume-weighted mean of their tetrahedra's."""
    edges = edge_matrices(rest, tets)
    volumes = np.linalg.det(edges)
    gradient = edge_matrices(posed, tets) @ np.linalg.inv(edges)
    total = np.empty((len(rest), 3, 3))
    weight = np.bincount(tets.ravel(), np.repeat(volumes, 4), minlength=len(rest))
    for a in range(3):
        for b in range(3):
            values = np.repeat(volumes * gradient[:, a, b], 4)
            total[:, a, b] = np.bincount(tets.ravel(), values, minlength=len(rest))
    return total / weight[:, None, None]


def boundary_faces(tets: Int[np.ndarray, "M 4"]) -> Int[np.ndarray, "F 3"]:
    """Faces that belong to one tetrahedron only, counter-clockwise from outside."""
    sides = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
    faces = tets[:, sides].reshape(-1, 3)
    _, first, count = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    return faces[np.sort(first[count == 1])]
