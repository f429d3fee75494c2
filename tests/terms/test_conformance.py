"""One conformance test for all terms: value, gradient, curvature and weight are checked the same way.

A term class without a case here fails ``test_every_term_has_a_case``: a new term is tested on registration.
"""

import importlib
import inspect
import pkgutil

import numpy as np
import pytest
import trimesh

import corporeal.terms
from corporeal.geometry.closest_points import SurfaceTree
from corporeal.geometry.normals import face_normals
from corporeal.geometry.self_intersection import PartSurfaces
from corporeal.geometry.topology import open_sides, unique_edges
from corporeal.solve.problem import PARAMETERS, Term
from corporeal.terms.coupling import EdgeCoupling
from corporeal.terms.distance import DistanceOptions
from corporeal.terms.gaussian_prior import GaussianPrior
from corporeal.terms.hinges import Hinges
from corporeal.terms.landmarks import LandmarkDistances
from corporeal.terms.mesh_pattern import MeshPattern
from corporeal.terms.part_separation import PartSeparation
from corporeal.terms.pose_limits import PoseLimits
from corporeal.terms.pose_mixture import MixturePrior
from corporeal.terms.scan_to_surface import MovingSurface, ScanToSurface
from corporeal.terms.surface_to_scan import ScanSurface, SurfaceToScan

STEP = 1e-6


def _sheet(rng, size=9, spacing=5e-3, bump=3e-3):
    """A curved open sheet of triangles, in metres."""
    u, v = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
    height = bump * np.sin(u * 0.7) * np.cos(v * 0.5)
    vertices = np.stack([u * spacing, v * spacing, height], -1).reshape(-1, 3)
    vertices = vertices + rng.normal(scale=2e-4, size=vertices.shape)
    corner = (u[:-1, :-1] * size + v[:-1, :-1]).ravel()
    first = np.stack([corner, corner + size, corner + 1], 1)
    second = np.stack([corner + 1, corner + size, corner + size + 1], 1)
    return vertices, np.concatenate([first, second])


def _scan_to_surface(rng, sigma, robust_scale=np.inf, tangential=1.0):
    vertices, faces = _sheet(rng)
    points = vertices[faces].mean(1) + rng.normal(scale=1e-3, size=(len(faces), 3))
    options = DistanceOptions(sigma, robust_scale, tangential)
    term = ScanToSurface(
        "data",
        "model",
        MovingSurface(vertices, faces),
        points,
        rng.uniform(0.5, 2, len(points)),
        None,
        options,
    )
    return term, {"model": vertices}


def _surface_to_scan(rng, sigma, robust_scale=np.inf, tangential=1.0, outside=False):
    vertices, faces = _sheet(rng)
    scan_vertices, scan_faces = _sheet(rng, size=21, spacing=2.3e-3)
    scan = ScanSurface(
        SurfaceTree(scan_vertices, scan_faces),
        face_normals(scan_vertices, scan_faces),
        open_sides(scan_faces),
    )
    options = DistanceOptions(sigma, robust_scale, tangential)
    weights = rng.uniform(0.5, 2, len(vertices))
    moved = vertices + rng.normal(scale=3e-4, size=vertices.shape) + [1e-3, 1.3e-3, 8e-4]
    surface = MovingSurface(vertices, faces)
    return SurfaceToScan("back", "model", surface, scan, weights, options, outside), {"model": moved}


def _coupling(rng, sigma):
    vertices, faces = _sheet(rng)
    term = EdgeCoupling(
        "coupling",
        ("free", "model"),
        unique_edges(faces),
        len(vertices),
        sigma=sigma,
        position_sigma=9 * sigma,
    )
    return term, {"model": vertices, "free": vertices + rng.normal(scale=1e-3, size=vertices.shape)}


def _landmarks(rng, sigma, robust_scale=np.inf):
    targets = rng.normal(scale=0.05, size=(21, 3))
    term = LandmarkDistances("landmarks", "landmarks", targets, np.full(21, sigma), robust_scale)
    return term, {"landmarks": targets + rng.normal(scale=0.01, size=(21, 3))}


def _gaussian(rng, sigma):
    root = rng.normal(size=(6, 6))
    precision = (root @ root.T + np.eye(6)) / sigma**2
    return GaussianPrior("prior", slice(2, 8), rng.normal(size=6), precision), {
        PARAMETERS: rng.normal(size=10)
    }


def _mixture(rng, sigma, weighted=False):
    roots = rng.normal(size=(3, 5, 5))
    covariances = np.einsum("mij,mkj->mik", roots, roots) + 0.2 * np.eye(5)
    term = MixturePrior(
        "mixture",
        slice(1, 6),
        np.array([0.2, 0.5, 0.3]),
        rng.normal(size=(3, 5)),
        covariances,
        sigma_scale=1.0 if weighted else sigma,
        weight=1 / sigma**2 if weighted else 1.0,
    )
    return term, {PARAMETERS: rng.normal(size=8)}


def _limits(rng, sigma):
    limits = np.stack([np.full(6, -0.5), np.full(6, 0.4)], 1)
    return PoseLimits("limits", slice(0, 6), limits, sigma), {PARAMETERS: 2 * rng.normal(size=7)}


def _hinges(rng, sigma):
    """Three of five joints."""
    frames = np.linalg.qr(rng.normal(size=(3, 3, 3)))[0]
    term = Hinges("hinges", slice(1, 16), np.array([1, 3, 4]), frames[:, 0], frames[:, 1], sigma)
    return term, {PARAMETERS: rng.normal(size=18)}


def _separation(rng, sigma):
    """Two closed boxes of triangles, the one standing 2 mm in the other."""
    first, faces = _box(rng)
    second = first + [0.018, 0.003, 0.002]
    vertices = np.concatenate([first, second])
    faces = np.concatenate([faces, faces + len(first)])
    labels = np.repeat([0, 1], len(first))
    parts = PartSurfaces(vertices, faces, labels)
    return PartSeparation("apart", "model", faces, parts, MeshPattern(faces, len(vertices)), sigma), {
        "model": vertices
    }


def _box(rng, size=0.02):
    mesh = trimesh.creation.box([size] * 3).subdivide().subdivide().subdivide()
    return mesh.vertices + rng.normal(scale=1e-5, size=mesh.vertices.shape), mesh.faces.astype(np.int64)


CASES = {
    "ScanToSurface": [
        ("plain", _scan_to_surface, {}),
        ("robust", _scan_to_surface, {"robust_scale": 2e-3}),
        ("sliding", _scan_to_surface, {"robust_scale": 2e-3, "tangential": 0.1}),
    ],
    "SurfaceToScan": [
        ("plain", _surface_to_scan, {}),
        ("sliding", _surface_to_scan, {"robust_scale": 2e-3, "tangential": 0.1}),
        ("outside", _surface_to_scan, {"robust_scale": 2e-3, "tangential": 0.1, "outside": True}),
    ],
    "PartSeparation": [("plain", _separation, {})],
    "EdgeCoupling": [("plain", _coupling, {})],
    "LandmarkDistances": [("plain", _landmarks, {}), ("robust", _landmarks, {"robust_scale": 3.0})],
    "GaussianPrior": [("plain", _gaussian, {})],
    "MixturePrior": [("plain", _mixture, {}), ("weighted", _mixture, {"weighted": True})],
    "PoseLimits": [("plain", _limits, {})],
    "Hinges": [("plain", _hinges, {})],
}
# Terms in metres have sigmas of millimetres, terms in radians or coefficients of tenths.
SIGMAS = {"GaussianPrior": 0.5, "MixturePrior": 0.7, "PoseLimits": 0.3, "Hinges": 0.03}
# The constants of a mixture do not scale with its sigma, nor does a robust scale given in units of sigma.
NOT_PURE = {"MixturePrior-plain", "LandmarkDistances-robust"}
FLAT = [
    pytest.param(name, make, options, id=f"{name}-{label}")
    for name, cases in CASES.items()
    for label, make, options in cases
]


def _built(name, make, options, rng, factor=1.0):
    return make(rng, SIGMAS.get(name, 1e-3) * factor, **options)


def _moved(fields, direction, step):
    return {name: value + step * direction[name] for name, value in fields.items()}


def _directions(rng, fields, scale):
    return {name: scale * rng.normal(size=value.shape) for name, value in fields.items()}


def _slope(quadratic, direction):
    return sum(float(np.sum(g * direction[name])) for name, g in quadratic.gradient.items())


def _bend(quadratic, direction):
    total = 0.0
    for (a, b), block in quadratic.curvature.items():
        left, right = direction[a].reshape(-1), direction[b].reshape(-1, 1)
        product = float(left @ block.times(right)[:, 0])
        total += product if a == b else 2 * product
    return total


def test_every_term_has_a_case():
    found = set()
    for module in pkgutil.iter_modules(corporeal.terms.__path__, "corporeal.terms."):
        if module.name.endswith("kernels"):
            continue
        for name, member in inspect.getmembers(importlib.import_module(module.name), inspect.isclass):
            own = member.__module__ == module.name
            takes_fields = "at" in vars(member) and "fields" in inspect.signature(member.at).parameters
            if own and takes_fields:
                found.add(name)
    assert found == set(CASES)


@pytest.mark.parametrize(("name", "make", "options"), FLAT)
class TestConformance:
    def test_it_is_a_term_with_a_cost_that_is_not_negative(self, name, make, options, rng):
        term, fields = _built(name, make, options, rng)
        assert isinstance(term, Term)
        assert term.at(fields).cost > 0

    def test_the_gradient_is_that_of_the_cost(self, name, make, options, rng):
        term, fields = _built(name, make, options, rng)
        quadratic = term.at(fields).quadratic()
        scale = 1e-3 if name not in SIGMAS else 1.0
        for _ in range(5):
            direction = _directions(rng, fields, scale)
            up = term.at(_moved(fields, direction, STEP)).cost
            down = term.at(_moved(fields, direction, -STEP)).cost
            numeric, analytic = (up - down) / (2 * STEP), _slope(quadratic, direction)
            size = max(abs(analytic), 1e-3 * term.at(fields).cost)
            assert abs(numeric - analytic) < 2e-6 * size + 1e-9 * term.at(fields).cost / STEP * 1e-3

    def test_the_curvature_is_symmetric_and_never_negative(self, name, make, options, rng):
        term, fields = _built(name, make, options, rng)
        quadratic = term.at(fields).quadratic()
        for _ in range(5):
            assert _bend(quadratic, _directions(rng, fields, 1.0)) >= 0
        for (a, b), block in quadratic.curvature.items():
            if a == b:
                matrix = block.dense()
                assert np.abs(matrix - matrix.T).max() <= 1e-12 * np.abs(matrix).max()


@pytest.mark.parametrize(("name", "make", "options"), [case for case in FLAT if case.id not in NOT_PURE])
def test_halving_sigma_counts_four_times(name, make, options, rng):
    term, fields = _built(name, make, options, rng)
    halved, _ = _built(name, make, options, np.random.default_rng(20171), factor=0.5)
    assert halved.at(fields).cost == pytest.approx(4 * term.at(fields).cost, rel=1e-9)


@pytest.mark.parametrize("name", ["EdgeCoupling", "GaussianPrior", "LandmarkDistances"])
def test_quadratic_terms_are_predicted_exactly(name, rng):
    _, make, options = CASES[name][0]
    term, fields = _built(name, make, options, rng)
    value = term.at(fields)
    direction = _directions(rng, fields, 1e-2)
    predicted = value.cost + _slope(value.quadratic(), direction) + 0.5 * _bend(value.quadratic(), direction)
    assert term.at(_moved(fields, direction, 1.0)).cost == pytest.approx(predicted, rel=1e-9)


@pytest.mark.parametrize("outside", [False, True])
def test_vertices_without_weight_are_as_if_they_were_not_there(rng, outside):
    term, fields = _surface_to_scan(rng, 1e-3, robust_scale=2e-3, tangential=0.1, outside=outside)
    half = np.arange(len(term.weights)) % 2 == 0
    shares = [np.where(kept, term.weights, 0.0) for kept in (half, ~half)]
    parts = [
        SurfaceToScan("part", "model", term.surface, term.scan, weights, term.options, outside)
        for weights in shares
    ]
    values = [part.at(fields) for part in parts]
    whole = term.at(fields)
    assert sum(value.cost for value in values) == pytest.approx(whole.cost, rel=1e-12)
    slopes = [value.quadratic().gradient["model"] for value in values]
    assert np.allclose(slopes[0] + slopes[1], whole.quadratic().gradient["model"], rtol=1e-12, atol=0)
    assert (slopes[0][~half] == 0).all() and (slopes[1][half] == 0).all()
    bends = [value.quadratic().curvature["model", "model"].dense() for value in (*values, whole)]
    assert np.allclose(bends[0] + bends[1], bends[2], rtol=1e-12, atol=0)


def test_unmatched_points_cost_what_the_robust_function_gives_at_infinity(rng):
    term, fields = _scan_to_surface(rng, 1e-3, robust_scale=2e-3)
    far = ScanToSurface(
        "far", "model", term.surface, term.points + [10.0, 0, 0], term.weights, None, term.options
    )
    value = far.at(fields)
    assert value.cost == pytest.approx(0.5 * term.weights.sum() * 4, rel=1e-4)
    assert np.abs(value.quadratic().gradient["model"]).max() < 1e-3


def test_the_mixture_keeps_its_determinants():
    means, covariances = np.zeros((2, 1)), np.array([[[1.0]], [[0.01]]])
    term = MixturePrior("m", slice(0, 1), np.array([0.5, 0.5]), means, covariances)
    # At the common mean the narrow component is the likelier one; far out the wide one is.
    assert term.at({PARAMETERS: np.zeros(1)}).cost == 0
    assert term.at({PARAMETERS: np.ones(1)}).cost == pytest.approx(0.5 + 0.5 * np.log(100))
