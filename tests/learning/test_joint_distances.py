"""Geodesic distances of vertices to joints against an exact oracle."""

import numpy as np
import pytest
import scipy.sparse as sp

from corporeal.learning.joint_distances import geodesic_joint_distances
from corporeal.learning.training_set import LearningError
from corporeal.model.files import open_model

pygeodesic = pytest.importorskip("pygeodesic.geodesic")


@pytest.fixture(scope="module")
def hand():
    return open_model("hand")


def test_are_means_of_exact_distances(hand, rng):
    exact = pygeodesic.PyGeodesicAlgorithmExact(hand.template, hand.faces)
    rows = np.zeros((2, hand.vertex_count))
    for row in rows:
        ring = rng.choice(hand.vertex_count, 3, replace=False)
        row[ring] = rng.dirichlet(np.ones(3))
    found = geodesic_joint_distances(hand.template, hand.faces, sp.csr_matrix(rows))
    wanted = [
        sum(
            row[source] * exact.geodesicDistances(np.array([source]), None)[0]
            for source in np.flatnonzero(row)
        )
        for row in rows
    ]
    relative = np.abs(found - wanted) / np.maximum(wanted, 0.01)
    assert np.median(relative) < 0.05
    assert relative.max() < 0.15
    assert found.min() >= 0


def test_go_along_the_surface(hand):
    """From finger tip to finger tip the way leads over the knuckles."""
    columns = [hand.landmarks["hand_21_mediapipe"].names.index(f"{name}_tip") for name in ("index", "middle")]
    tips = [int(hand.landmarks["hand_21_mediapipe"].weights[column].indices[0]) for column in columns]
    row = sp.csr_matrix(([1.0], ([0], [tips[0]])), shape=(1, hand.vertex_count))
    apart = np.linalg.norm(hand.template[tips[0]] - hand.template[tips[1]])
    assert geodesic_joint_distances(hand.template, hand.faces, row)[0, tips[1]] > 3 * apart


def test_a_template_in_pieces_is_refused(hand):
    twice = np.concatenate([hand.template, hand.template + 0.3])
    faces = np.concatenate([hand.faces, hand.faces + hand.vertex_count])
    row = sp.csr_matrix(([1.0], ([0], [5])), shape=(1, len(twice)))
    with pytest.raises(LearningError, match="template: 2931 of 5862 vertices do not hang together"):
        geodesic_joint_distances(twice, faces, row)
