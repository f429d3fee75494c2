"""Quasi-static soft flesh on rigid bones: the bulges and creases that a skinned hand or body lacks.

Either is a tetrahedral mesh; vertices near the bones move with them, the others settle where a nearly
incompressible hyperelastic energy is smallest, and skin pushes skin apart where it meets.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Int

from corporeal.geometry.normals import vertex_normals
from corporeal.scans.simulation import flesh_kernels as kernels
from corporeal.scans.simulation.tetrahedra import boundary_faces, edge_matrices, laplacian
from corporeal.solve.quasi_newton import QuasiNewtonOptions, Settled, descend
from corporeal.solve.sparse import Factorisation, factorised

_MM = 1e3
# Skin meets skin along the normal; within this share of the reach any direction will do.
_ALIGNED, _CLOSE = 0.75, 0.05


@dataclass(frozen=True)
class FleshOptions:
    """How soft, and how well settled; lengths are a hand's.

    Attributes:
        poisson: Poisson's ratio; 0.5 would be incompressible and locks linear tetrahedra.
        thickness: distance in metres at which skin begins to push skin away.
        contact: pressure per depth, in shear moduli per millimetre.
        rest_gap: skin of one part closer than this at rest (metres) does not push itself.
        part_gap: nor does that of two parts closer than this: they grow together there.
        reach: metres within which skin looks for other skin: two or three edges of the tetrahedra.
        increments: steps from rest to the full pose, so small that fingers cannot pass through one another.
        iterations: most solver steps at the full pose; half as many at the others.
        tolerance: metres, largest movement of a vertex in a step below which the flesh has settled.
    """

    poisson: float = 0.47
    thickness: float = 0.3e-3
    contact: float = 20.0
    rest_gap: float = 12e-3
    part_gap: float = 5e-3
    reach: float = 6e-3
    increments: int = 4
    iterations: int = 240
    tolerance: float = 0.02e-3


@dataclass(frozen=True, eq=False)
class PosedFlesh:
    """The settled hand.

    Attributes:
        vertices: (T, 3) metres.
        smallest_det: smallest determinant of a deformation gradient; negative where an element is inverted.
        deepest: metres, how deep skin stands in other skin.
        volume_ratio: volume against rest.
        iterations: solver steps in all.
        converged: whether the tolerance was met.
    """

    vertices: Float[np.ndarray, "T 3"]
    smallest_det: float
    deepest: float
    volume_ratio: float
    iterations: int
    converged: bool


class SoftBody:
    """Tetrahedra with bones inside, made once for one person."""

    def __init__(
        self,
        rest: Float[np.ndarray, "T 3"],
        tets: Int[np.ndarray, "M 4"],
        weights: Float[np.ndarray, "T K"],
        bone: Int[np.ndarray, " T"],
        part: Int[np.ndarray, " T"],
        options: FleshOptions | None = None,
    ) -> None:
        """Prepare one person.

        Args:
            rest: metres.
            tets: positive volumes.
            weights: skinning weights of the vertices: the first guess of where they go.
            bone: the bone that a vertex is fixed to, -1 for flesh.
            part: finger, palm: skin of one part meets only skin that looked the same way at rest.
            options: material and solver.

        Raises:
            ValueError: an element is flat or inverted at rest, or no vertex is fixed.
        """
        self.options = options or FleshOptions()
        self._rest = _MM * np.ascontiguousarray(rest)
        self._tets = np.ascontiguousarray(tets, dtype=np.int64)
        self._weights, self._bone = weights, bone
        edges = edge_matrices(self._rest, self._tets)
        volumes = np.linalg.det(edges) / 6
        if not (volumes > 0).all():
            raise ValueError(f"tets: {int((volumes <= 0).sum())} elements are flat or inverted at rest")
        if not (bone >= 0).any():
            raise ValueError("bone: no vertex is fixed to a bone")
        self._volumes = volumes
        self._inverse_rest = np.ascontiguousarray(np.linalg.inv(edges))
        ratio = self.options.poisson
        # Smith et al. 2018, section 3.4: so that small strains see these moduli.
        self._mu, self._lam = 4 / 3, 2 * ratio / (1 - 2 * ratio) + 5 / 6
        self._free = np.flatnonzero(bone < 0)
        self._skin = _Skin(self._rest, self._tets, part)

    @cached_property
    def _stiffness(self) -> Factorisation:
        """The stand-in for the Hessian: a Laplacian of the free vertices."""
        matrix = laplacian(self._rest, self._tets)
        free = matrix[self._free][:, self._free]
        return factorised(sp.csr_matrix((2 * self._mu + self._lam) * free))

    def skinned(self, motions: Float[np.ndarray, "K 4 4"]) -> Float[np.ndarray, "T 3"]:
        """Linear skinning of the same hand, metres."""
        return _carried(self._rest / _MM, self._weights, motions)

    def posed(self, steps: Float[np.ndarray, "n K 4 4"]) -> PosedFlesh:
        """Settle the flesh at a sequence of bone motions, the last of which is the pose asked for.

        Args:
            steps: motion of every bone from rest, metres, in the world frame.
        """
        x, previous = self._rest.copy(), np.tile(np.eye(4), (steps.shape[1], 1, 1))
        iterations = 0
        settled: Settled | None = None
        for number, motions in enumerate(steps, start=1):
            x = self._guess(x, previous, motions)
            last = number == len(steps)
            settled = self._settle(x, last=last)
            x[self._free] = settled.x
            iterations += settled.iterations
            previous = motions
        gradient = np.zeros_like(x)
        _, smallest = kernels.elastic_forces(
            x, self._tets, self._inverse_rest, self._volumes, self._mu, self._lam, gradient
        )
        volume = np.linalg.det(edge_matrices(x, self._tets)).sum() / 6
        converged = settled is not None and settled.converged
        ratio, deepest = float(volume / self._volumes.sum()), self._skin.deepest(x, self.options) / _MM
        return PosedFlesh(x / _MM, float(smallest), deepest, ratio, iterations, converged)

    def _guess(self, x: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Flesh carried on from one pose to the next by its bones; fixed vertices where they belong."""
        change = after @ np.linalg.inv(before)
        change[:, :3, 3] = _MM * change[:, :3, 3]
        guess = _carried(x, self._weights, change)
        fixed = self._bone >= 0
        motion = after[self._bone[fixed]]
        guess[fixed] = np.einsum("vab,vb->va", motion[:, :3, :3], self._rest[fixed]) + _MM * motion[:, :3, 3]
        return guess

    def _settle(self, x: np.ndarray, *, last: bool) -> Settled:
        options, skin, free = self.options, self._skin, self._free
        whole = x.copy()
        contacts = skin.contacts(whole, options)

        def energy(points: np.ndarray) -> tuple[float, np.ndarray]:
            whole[free] = points
            gradient = np.zeros_like(whole)
            value, _ = kernels.elastic_forces(
                whole, self._tets, self._inverse_rest, self._volumes, self._mu, self._lam, gradient
            )
            vertices, corners, weights, normals, stiffness = contacts
            thickness = _MM * options.thickness
            value += kernels.contact_forces(
                whole, vertices, corners, weights, normals, stiffness, thickness, gradient
            )
            return value, gradient[free]

        def refresh(points: np.ndarray) -> bool:
            nonlocal contacts
            whole[free] = points
            contacts = skin.contacts(whole, options)
            return True

        limits = QuasiNewtonOptions(
            iterations=options.iterations if last else options.iterations // 3,
            tolerance=_MM * options.tolerance * (1 if last else 5),
        )
        return descend(energy, x[free], self._stiffness.solve, limits, refresh)


class _Skin:
    """The boundary of the tetrahedra, in millimetres, and where it meets itself."""

    def __init__(self, rest: np.ndarray, tets: np.ndarray, part: np.ndarray) -> None:
        self._faces = boundary_faces(tets)
        self._used, local = np.unique(self._faces, return_inverse=True)
        self._local = local.reshape(-1, 3)
        self._rest = rest[self._used]
        self._parts = part[self._used].astype(np.int64)
        self._rest_normals = vertex_normals(self._rest, self._local)
        order = np.argsort(self._local.ravel(), kind="stable")
        self._face_lists = order // 3
        self._face_starts = np.searchsorted(self._local.ravel()[order], np.arange(len(self._used) + 1))
        corners = self._rest[self._local]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(cross, axis=1) / 2
        self._areas = np.bincount(self._local.ravel(), np.repeat(areas / 3, 3))

    def contacts(self, x: np.ndarray, options: FleshOptions) -> tuple[np.ndarray, ...]:
        """Vertex, face, barycentric weights, normal and stiffness of every pair that may touch."""
        points = np.ascontiguousarray(x[self._used])
        normals = vertex_normals(points, self._local)
        reach = _MM * options.reach
        low = points.min(0) - 1e-6
        shape = ((points.max(0) - low) / reach).astype(np.int64) + 1
        starts, members = kernels.cell_lists(points, low, reach, shape)
        gaps = (_MM * options.rest_gap, _MM * options.part_gap)
        own = (self._rest, self._rest_normals, self._parts, self._face_starts, self._face_lists, self._local)
        face, weights = kernels.contact_pairs(
            own, points, normals, gaps, reach, (low, shape, starts, members)
        )
        pairs = np.flatnonzero(face >= 0)
        corners = self._local[face[pairs]]
        normal = np.einsum("pi,pia->pa", weights[pairs], normals[corners])
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
        # A vertex that lies beside the end of a face's neighbourhood has not met it.
        offset = points[pairs] - np.einsum("pi,pia->pa", weights[pairs], points[corners])
        aligned = np.abs(np.einsum("pa,pa->p", normal, offset))
        met = aligned > _ALIGNED * np.linalg.norm(offset, axis=1) - _CLOSE * reach
        pairs, corners, normal = pairs[met], corners[met], normal[met]
        stiffness = options.contact * self._areas[pairs]
        return self._used[pairs], self._used[corners], weights[pairs], normal, stiffness

    def deepest(self, x: np.ndarray, options: FleshOptions) -> float:
        """How deep a vertex lies behind the face that it meets, millimetres."""
        vertices, corners, weights, normals, _ = self.contacts(x, options)
        on_face = np.einsum("pi,pia->pa", weights, x[corners])
        return float(-np.einsum("pa,pa->p", normals, x[vertices] - on_face).min(initial=0.0))


def _carried(points: np.ndarray, weights: np.ndarray, motions: np.ndarray) -> np.ndarray:
    blended = np.einsum("vk,kab->vab", weights, motions[:, :3])
    return np.einsum("vab,vb->va", blended[:, :, :3], points) + blended[:, :, 3]
