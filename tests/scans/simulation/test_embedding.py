"""The open hand's template lies on the simulator's skin as it should: joints, parts and orientation."""

from importlib.resources import files

import numpy as np
import pytest

from corporeal.geometry.normals import face_normals, vertex_normals
from corporeal.geometry.subdivision import loop_step
from corporeal.scans.simulation.files import HandSimulator, load_simulator
from corporeal.scans.simulation.identities import hand_at_rest, sample_subjects


@pytest.fixture(scope="module")
def simulator() -> HandSimulator:
    return load_simulator()


@pytest.fixture(scope="module")
def open_hand() -> dict[str, np.ndarray]:
    packed = files("corporeal") / "model" / "open_models" / "start_hand.npz"
    with packed.open("rb") as stream, np.load(stream) as model:
        return {name: model[name] for name in ("f", "v_template", "weights", "J_regressor")}


def _embedded(simulator: HandSimulator, surface: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Template vertices on the skin, and the skin's normals there."""
    step = loop_step(simulator.surface_faces, len(surface))
    fine = step(surface)
    corners = step.faces[simulator.template_faces]
    normals = vertex_normals(fine, step.faces)
    shares = simulator.template_barycentric
    return (
        np.einsum("pc,pca->pa", shares, fine[corners]),
        np.einsum("pc,pca->pa", shares, normals[corners]),
    )


def test_no_triangle_is_flipped_or_degenerate(simulator, open_hand):
    faces = open_hand["f"].astype(np.int64)
    surfaces = [simulator.surface_vertices]
    surfaces += [hand_at_rest(simulator, subject, "right")[0] for subject in sample_subjects(simulator, 4, 8)]
    for surface in surfaces:
        template, normals = _embedded(simulator, surface)
        own = face_normals(template, faces)
        assert np.einsum("fa,fa->f", own, normals[faces].mean(1)).min() > 0.2
        sides = template[faces[:, 1:]] - template[faces[:, :1]]
        areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
        assert areas.min() > 0.1e-6


def test_edges_keep_their_lengths(simulator, open_hand):
    """Both hands are adults of the same source: nothing is stretched by more than shapes and poses do."""
    template, _ = _embedded(simulator, simulator.surface_vertices)
    faces = open_hand["f"]
    edges = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    here, there = (
        np.linalg.norm(points[edges[:, 0]] - points[edges[:, 1]], axis=1)
        for points in (template, open_hand["v_template"])
    )
    ratio = here / there
    assert 0.9 < np.median(ratio) < 1.05
    low, high = np.quantile(ratio, [0.01, 0.99])
    assert low > 0.65
    assert high < 1.3


def test_the_template_s_joints_lie_in_the_simulator_s(simulator, open_hand):
    template, _ = _embedded(simulator, simulator.surface_vertices)
    joints = open_hand["J_regressor"] @ template
    apart = np.linalg.norm(joints - simulator.joints[1:17], axis=1)
    # Half the distance of the source's two rigs: the simulator's joints lie between them.
    assert apart.max() < 9e-3
    assert apart.mean() < 5e-3


def test_fingers_lie_on_the_same_fingers(simulator, open_hand):
    step = loop_step(simulator.surface_faces, len(simulator.surface_vertices))
    corners = step.faces[simulator.template_faces]
    weights = np.einsum("pc,pck->pk", simulator.template_barycentric, step(simulator.weights)[corners])
    part_of_bone = np.concatenate([[0, 0], np.repeat(np.arange(1, 6), 3)])
    here = part_of_bone[weights.argmax(1)]
    there = part_of_bone[1:][open_hand["weights"].argmax(1)]
    # In the webs both rigs share the skin between neighbours.
    clear = (here > 0) & (there > 0) & (weights.max(1) > 0.7)
    assert clear.sum() > 1400
    np.testing.assert_array_equal(here[clear], there[clear])


def test_finger_tips_are_reached(simulator, open_hand):
    template, _ = _embedded(simulator, simulator.surface_vertices)
    strongest = open_hand["weights"].argmax(1)
    for finger, tip in enumerate(simulator.joints[17:]):
        bone = tip - simulator.joints[4 + 3 * finger]
        bone /= np.linalg.norm(bone)
        skin = simulator.surface_vertices[simulator.weights.argmax(1) == 4 + 3 * finger]
        own = template[strongest == 3 * finger + 3]
        assert abs((skin @ bone).max() - (own @ bone).max()) < 0.5e-3
