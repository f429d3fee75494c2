"""Areas about vertices."""

import numpy as np

from corporeal.geometry.normals import areas_around, face_areas
from corporeal.model.files import open_model


def test_areas_around_vertices_are_those_of_their_faces():
    hand = open_model("hand")
    found, areas = areas_around(hand.template, hand.faces), face_areas(hand.template, hand.faces)
    for vertex in (0, 100, hand.vertex_count - 1):
        np.testing.assert_allclose(found[vertex], areas[(hand.faces == vertex).any(axis=1)].sum())
    np.testing.assert_allclose(found.sum(), 3 * areas.sum())


def test_a_vertex_of_no_face_has_none():
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [5.0, 5.0, 5.0]])
    np.testing.assert_allclose(areas_around(triangle, np.array([[0, 1, 2]])), [0.5, 0.5, 0.5, 0.0])
