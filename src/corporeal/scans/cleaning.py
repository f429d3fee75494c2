"""Mends what scanners write: soups, specks, wild points, faces inside out; and says what it did."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float, Int
from scipy.sparse import csgraph
from scipy.spatial import cKDTree

from corporeal.geometry.normals import face_areas, vertex_normals
from corporeal.geometry.topology import (
    boundary_edges,
    connected_components,
    remove_unreferenced,
    signed_volume,
    weld,
)
from corporeal.scans.point_normals import point_normals
from corporeal.scans.raw import RawScan

WELD_TOLERANCE = 1e-6
"""Of the diagonal: 0.4 micrometres for a hand; float32 coordinates a metre from the origin are 0.06 apart."""

SPECK_AREA = 0.02
"""Parts with less than this share of the largest part's area (or points) are specks."""

WILD_DISTANCE = 100.0
"""Points farther from the middle than this many times the median distance are no part of the capture."""

# Three indices below it, one behind the other, fit into 63 bits.
_FITS_CUBED = 2_000_000
LEAST_CLOUD = 64
"""Points that a cloud must keep: fewer tell no surface."""

_SPECK_NEIGHBOURS = 8
_GAP = 5.0


def clean(raw: RawScan) -> RawScan:
    """A mesh or cloud with finite points, welded, without specks, facing outward; normals are always given.

    Nothing depends on the unit: all tolerances are relative. ``notes`` gains a sentence per kind of repair.

    Raises:
        ValueError: nothing is left that could be a surface.
    """
    steps: tuple[Callable[[RawScan], RawScan], ...]
    if len(raw.faces):
        steps = (drop_wild, _weld, _drop_bad_faces, _drop_specks, _turn_outward, _state_edges, _face_normals)
    else:
        steps = (drop_wild, _weld, _checked_cloud, _drop_sparse_specks, _cloud_normals)
    for step in steps:
        raw = step(raw)
    return raw


def _noted(raw: RawScan, sentence: str) -> RawScan:
    return dataclasses.replace(raw, notes=(*raw.notes, sentence))


def _kept(raw: RawScan, mask: Bool[np.ndarray, " N"]) -> RawScan:
    """Points of the mask, and the faces that keep all corners."""
    faces = raw.faces[mask[raw.faces].all(axis=1)]
    return _picked(raw, np.flatnonzero(mask), (np.cumsum(mask) - 1)[faces])


def _picked(raw: RawScan, points: Int[np.ndarray, " W"], faces: Int[np.ndarray, "G 3"]) -> RawScan:
    return dataclasses.replace(
        raw,
        points=raw.points[points],
        faces=faces.astype(np.int64).reshape(-1, 3),
        colours=None if raw.colours is None else raw.colours[points],
        normals=None if raw.normals is None else raw.normals[points],
    )


def drop_wild(raw: RawScan) -> RawScan:
    """Points that are not finite, or so far away that they can only be broken numbers."""
    finite = np.isfinite(raw.points).all(axis=1)
    if not finite.any():
        raise ValueError("it holds no point with finite coordinates")
    # The greatest coordinate difference, not the Euclidean distance: squares of wild numbers overflow.
    with np.errstate(over="ignore", invalid="ignore"):
        middle = np.median(raw.points[finite], axis=0)
        distance = np.abs(raw.points - middle).max(axis=1)
        typical = np.median(distance[finite])
        near = finite & (distance <= WILD_DISTANCE * typical)
    if not 1e-30 < typical < 1e30:  # beyond, squares of areas leave the range of float64
        raise ValueError("its points have no extent, or one that is no length")
    if not finite.all():
        raw = _noted(raw, f"Points with NaN or infinite coordinates dropped: {(~finite).sum()}.")
    if (finite & ~near).any():
        raw = _noted(raw, f"Points far outside of the scan dropped: {(finite & ~near).sum()}.")
    return raw if near.all() else _kept(raw, near)


def _weld(raw: RawScan) -> RawScan:
    tolerance = WELD_TOLERANCE * float(np.linalg.norm(np.ptp(raw.points, axis=0)))
    points, faces, new_index = weld(raw.points, raw.faces, tolerance)
    if len(points) == len(raw.points):
        return _picked(raw, np.arange(len(points)), faces)
    first = np.full(len(points), len(raw.points))
    np.minimum.at(first, new_index, np.arange(len(raw.points)))
    welded = _picked(raw, first, faces)
    return _noted(welded, f"Points welded: {len(raw.points)} to {len(points)}.")


def _drop_bad_faces(raw: RawScan) -> RawScan:
    """Faces without an area and faces that are there twice, then points that no face uses."""
    flat = face_areas(raw.points, raw.faces) <= 0
    kept = raw.faces[~flat]
    keys = _corner_keys(kept, len(raw.points))
    if flat.any():
        raw = _noted(raw, f"Faces without area dropped: {flat.sum()}.")
    if _has_equal(keys):
        _, first = np.unique(keys, return_index=True)
        raw = _noted(raw, f"Faces that were there twice dropped: {len(kept) - len(first)}.")
        kept = kept[np.sort(first)]
    return _drop_unused(dataclasses.replace(raw, faces=kept))


def _has_equal(keys: Int[np.ndarray, " n"]) -> bool:
    """Whether a number occurs twice: a tenth of the time that it takes to say where."""
    ordered = np.sort(keys)
    return bool((ordered[1:] == ordered[:-1]).any())


def _corner_keys(faces: Int[np.ndarray, "F 3"], count: int) -> Int[np.ndarray, " F"]:
    """One number for each set of corners: sorting numbers takes a fifth of the time of sorting rows."""
    a, b, c = faces.T
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    middle = a + b + c - low - high
    if count < _FITS_CUBED:
        return (low * count + middle) * count + high
    edges = np.unique(low * count + high, return_inverse=True)[1].ravel()
    return edges * count + middle


def _drop_unused(raw: RawScan) -> RawScan:
    if len(raw.faces) == 0:
        raise ValueError("no face with an area is left")
    _, faces, old_index = remove_unreferenced(raw.points, raw.faces)
    if len(old_index) == len(raw.points):
        return raw
    unused = len(raw.points) - len(old_index)
    return _noted(_picked(raw, old_index, faces), f"Points that no face uses dropped: {unused}.")


def _drop_specks(raw: RawScan) -> RawScan:
    labels = connected_components(raw.faces, len(raw.points))
    areas = np.bincount(labels[raw.faces[:, 0]], face_areas(raw.points, raw.faces))
    small = areas < SPECK_AREA * areas.max()
    if not small.any():
        return raw
    sentence = f"Parts with less than {SPECK_AREA:.0%} of the area of the largest dropped: {small.sum()}."
    return _noted(_kept(raw, ~small[labels]), sentence)


def _turn_outward(raw: RawScan) -> RawScan:
    """Turn all faces over if the scan is inside out.

    The sign of the volume decides where the scan is closed or nearly so: a boundary up to twice the root of
    the area (a cut wrist has 0.6, the palm side of a hand alone 6), for there the sign means something.
    """
    boundary = boundary_edges(raw.faces)
    length = np.linalg.norm(raw.points[boundary[:, 0]] - raw.points[boundary[:, 1]], axis=1).sum()
    area = face_areas(raw.points, raw.faces).sum()
    if length > 2 * np.sqrt(area) or signed_volume(raw.points, raw.faces) >= 0:
        return raw
    turned = dataclasses.replace(raw, faces=np.ascontiguousarray(raw.faces[:, ::-1]))
    return _noted(turned, "All faces turned over: the surface was inside out.")


def _state_edges(raw: RawScan) -> RawScan:
    """Edges of more than two faces are kept, since cutting them would open holes, but stated."""
    corners = raw.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    if not _has_equal(corners[:, 0] * len(raw.points) + corners[:, 1]):
        # Of three faces at an edge, or of two that are wound alike, two run through it in one direction.
        return raw
    keys = np.minimum(*corners.T) * len(raw.points) + np.maximum(*corners.T)
    _, edge, face_count = np.unique(keys, return_inverse=True, return_counts=True)
    turns = np.bincount(edge.ravel(), np.where(corners[:, 0] < corners[:, 1], 1, -1))
    crowded = int((face_count > 2).sum())
    conflicting = int(((face_count == 2) & (turns != 0)).sum())
    if crowded:
        raw = _noted(raw, f"Edges with more than two faces kept: {crowded}.")
    if conflicting:
        raw = _noted(raw, f"Edges whose two faces have opposite windings kept: {conflicting}.")
    return raw


def _face_normals(raw: RawScan) -> RawScan:
    return dataclasses.replace(raw, normals=vertex_normals(raw.points, raw.faces))


def _checked_cloud(raw: RawScan) -> RawScan:
    if len(raw.points) < LEAST_CLOUD:
        raise ValueError(
            f"a point cloud needs at least {LEAST_CLOUD} different points; found {len(raw.points)}"
        )
    return raw


def _drop_sparse_specks(raw: RawScan) -> RawScan:
    """Points, and groups of them, that a gap parts from the rest.

    A gap is an edge to a near neighbour that is five times longer than the neighbour's own distance to its
    eighth; the measure follows the density of the cloud, which no fixed radius does.
    """
    labels = _gap_components(raw.points)
    sizes = np.bincount(labels)
    small = sizes < SPECK_AREA * sizes.max()
    if not small.any():
        return raw
    dropped = small[labels]
    sentence = f"Points apart from the rest dropped: {dropped.sum()} (groups: {small.sum()})."
    return _checked_cloud(_noted(_kept(raw, ~dropped), sentence))


def _gap_components(points: Float[np.ndarray, "N 3"]) -> Int[np.ndarray, " N"]:
    distances, nearest = cKDTree(points).query(points, k=_SPECK_NEIGHBOURS + 1, workers=-1)
    begins = np.repeat(np.arange(len(points)), _SPECK_NEIGHBOURS)
    ends, lengths = nearest[:, 1:].ravel(), distances[:, 1:].ravel()
    joined = lengths <= _GAP * distances[ends, -1]
    count = len(points)
    graph = sp.coo_matrix((np.ones(joined.sum()), (begins[joined], ends[joined])), shape=(count, count))
    return csgraph.connected_components(graph, directed=False)[1]


def _cloud_normals(raw: RawScan) -> RawScan:
    """The file's own normals if it has them, since the scanner knew where it stood; else estimated ones."""
    if raw.normals is not None and np.isfinite(raw.normals).all():
        length = np.linalg.norm(raw.normals, axis=1)
        if (length > 1e-6).all():
            return dataclasses.replace(raw, normals=raw.normals / length[:, None])
    raw = dataclasses.replace(raw, normals=point_normals(raw.points))
    return _noted(raw, "Normals estimated from neighbouring points.")
