"""Parts that pass through one another: depths that are known, and no false alarm on a hand."""

import igl
import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial.transform import Rotation

from corporeal.geometry.self_intersection import part_penetration, winding_numbers
from corporeal.geometry.topology import boundary_loops, is_edge_manifold, signed_volume
from corporeal.model.files import open_model
from corporeal.model.pose import FullPose

MILLIMETRE = 1e-3


def dense(mesh: trimesh.Trimesh, edge: float = 3e-3) -> tuple[np.ndarray, np.ndarray]:
    fine = mesh.subdivide_to_size(edge)
    fine.merge_vertices()
    return np.array(fine.vertices), np.array(fine.faces, dtype=np.int64)


def side_by_side(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    vertices = np.concatenate([vertices for vertices, _ in parts])
    faces = np.concatenate([faces + offset for (_, faces), offset in zip(parts, offsets, strict=False)])
    labels = np.repeat(np.arange(len(parts)), [len(vertices) for vertices, _ in parts])
    return vertices, faces, labels


def voxel_surface(cells: dict[tuple[int, int, int], int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Closed surface of labelled cells; a vertex takes the largest label of the cells it bounds."""
    index: dict[tuple[int, ...], int] = {}
    labels: dict[int, int] = {}
    faces = []
    for cell, label in cells.items():
        for axis in range(3):
            for sign in (0, 1):
                step = np.zeros(3, dtype=int)
                step[axis] = 2 * sign - 1
                if tuple(np.add(cell, step)) in cells:
                    continue
                u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
                base = np.array(cell) + sign * np.eye(3, dtype=int)[axis]
                corners = [base, base + u, base + u + v, base + v]
                ring = [index.setdefault(tuple(corner), len(index)) for corner in corners]
                ring = ring if sign else ring[::-1]
                faces += [ring[:3], [ring[0], *ring[2:]]]
                for vertex in ring:
                    labels[vertex] = max(labels.get(vertex, 0), label)
    vertices = np.array(list(index), dtype=float)
    return vertices, np.array(faces), np.array([labels[i] for i in range(len(vertices))])


FINGER_BASES = (0, 4, 8, 12)


def blocky_hand() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A palm (0) with four fingers (1-4) towards +y and a thumb (5) towards +x, open at the wrist; metres.

    Cells of 5 mm: fingers are 15 mm thick and 5 mm apart.
    """
    cells = {(x, y, z): 0 for x in range(15) for y in range(16) for z in range(4)}
    for label, base in enumerate(FINGER_BASES, start=1):
        cells |= {(base + x, 16 + y, z): label for x in range(3) for y in range(14) for z in range(3)}
    cells |= {(15 + x, 2 + y, z): 5 for x in range(10) for y in range(3) for z in range(3)}
    vertices, faces, labels = voxel_surface(cells)
    faces = faces[~(vertices[faces][:, :, 1] == 0).all(axis=1)]
    return vertices * 5 * MILLIMETRE, faces, labels


def test_the_hand_of_these_tests_is_a_hand() -> None:
    vertices, faces, labels = blocky_hand()
    assert is_edge_manifold(faces)
    assert len(boundary_loops(faces)) == 1
    assert signed_volume(vertices, faces) > 0
    assert set(labels) == set(range(6))


def test_winding_numbers_agree_with_libigl(rng: np.random.Generator) -> None:
    vertices, faces, _ = blocky_hand()
    points = rng.uniform(vertices.min(axis=0), vertices.max(axis=0), size=(200, 3))
    expected = igl.winding_number(vertices, faces, points)
    np.testing.assert_allclose(winding_numbers(points, vertices, faces), expected, atol=1e-9)


def test_a_flat_hand_has_no_penetration() -> None:
    found = part_penetration(*blocky_hand())
    assert found.deepest == 0
    assert len(found.vertices) == 0
    assert found.by_pair == {}


@pytest.mark.parametrize(("angle", "bound"), [(20, 0), (45, 0), (70, 0.3 * MILLIMETRE)])
def test_bending_fingers_alone_is_no_penetration(angle: float, bound: float) -> None:
    """Each finger turns about its base; only the folds at the border move into the palm.

    At 70 degrees a finger this thick truly cuts into the palm's edge, a little beyond the border left out.
    """
    vertices, faces, labels = blocky_hand()
    turn = Rotation.from_euler("x", -angle, degrees=True)
    for label, base in enumerate(FINGER_BASES, start=1):
        hinge = np.array([base + 1.5, 16, 1.5]) * 5 * MILLIMETRE
        members = labels == label
        vertices[members] = turn.apply(vertices[members] - hinge) + hinge
    assert part_penetration(vertices, faces, labels).deepest <= bound


@pytest.mark.parametrize("overlap", [0.5, 1, 3])
def test_a_finger_pushed_into_its_neighbour(overlap: float) -> None:
    vertices, faces, labels = blocky_hand()
    reach = np.clip((vertices[:, 1] - 80 * MILLIMETRE) / (30 * MILLIMETRE), 0, 1)
    vertices[:, 0] += np.where(labels == 2, reach * (5 + overlap) * MILLIMETRE, 0)
    found = part_penetration(vertices, faces, labels)
    assert found.deepest == pytest.approx(overlap * MILLIMETRE, rel=1e-9)
    assert list(found.by_pair) == [(2, 3)]
    assert set(found.own_parts) == {2, 3}
    foot = np.einsum("nc,ncd->nd", found.barycentric, vertices[faces[found.faces]])
    distance = np.linalg.norm(foot - vertices[found.vertices], axis=1)
    np.testing.assert_allclose(distance, found.depths, atol=1e-12)
    assert (labels[faces[found.faces]] == found.other_parts[:, None]).all()
    np.testing.assert_array_equal(labels[found.vertices], found.own_parts)


def test_a_finger_curled_through_the_palm() -> None:
    """A finger folded back, parallel to the palm, 4 mm under its skin: depth 4 mm."""
    vertices, faces, labels = blocky_hand()
    finger = labels == 3
    y = vertices[finger, 1] - 80 * MILLIMETRE
    folded = vertices[finger].copy()
    folded[:, 1] = 80 * MILLIMETRE - y
    folded[:, 2] = 20 * MILLIMETRE - 4 * MILLIMETRE + (15 * MILLIMETRE - vertices[finger, 2])
    vertices[finger] = folded
    found = part_penetration(vertices, faces, labels)
    assert found.by_pair.keys() >= {(0, 3)}
    assert found.by_pair[0, 3] == pytest.approx(4 * MILLIMETRE, rel=1e-9)


@pytest.mark.parametrize("depth", [0.2, 1.0, 5.0])
def test_boxes_and_cylinders_overlap_as_deep_as_they_were_placed(depth: float) -> None:
    box = dense(trimesh.creation.box((0.05, 0.02, 0.02)))
    cylinder = trimesh.creation.cylinder(radius=0.008, height=0.06, sections=64)
    cylinder.apply_translation([0, 0, 0.01 + 0.03 - depth * MILLIMETRE])
    found = part_penetration(*side_by_side(box, dense(cylinder)))
    assert found.deepest == pytest.approx(depth * MILLIMETRE, rel=1e-6)


def test_parts_that_only_touch_or_lie_apart() -> None:
    box = dense(trimesh.creation.box((0.02, 0.02, 0.02)))
    for gap in (1e-6, 0.01):
        other = (box[0] + [0.02 + gap, 0, 0], box[1])
        assert part_penetration(*side_by_side(box, other)).deepest == 0


def test_motion_and_order_of_labels_change_nothing() -> None:
    vertices, faces, labels = blocky_hand()
    vertices[labels == 2] += [7 * MILLIMETRE, 0, 0]
    before = part_penetration(vertices, faces, labels)
    turn = Rotation.random(random_state=5)
    after = part_penetration(turn.apply(vertices) + [1, -2, 3], faces, 9 - labels)
    assert before.deepest == pytest.approx(2 * MILLIMETRE)
    assert after.deepest == pytest.approx(before.deepest, rel=1e-9)
    # The tips of all fingers lie in one plane: on it a vertex is inside or outside by the last bit.
    inside_before, inside_after = (np.unique(each.vertices[each.depths > 1e-9]) for each in (before, after))
    np.testing.assert_array_equal(inside_after, inside_before)


@pytest.mark.parametrize(
    "turns",
    [
        {},
        {f"{finger}1": (0, 0, 0.9) for finger in ("index", "middle", "ring", "little")},
        {f"{finger}1": (0, 0, -0.9) for finger in ("index", "middle", "ring", "little")},
        # The thumb bends in free air; the fan that closes the palm bulges round its vertices.
        {"thumb1": (0.5, 0, -0.5), "thumb2": (0, -0.1, -0.1), "thumb3": (0.3, -0.4, 0.2)},
    ],
    ids=["flat", "flexed", "overstretched", "thumb"],
)
def test_no_false_alarm_on_the_open_hand(turns: dict[str, tuple[float, float, float]]) -> None:
    # The start hand: dual-quaternion bulges keep its thumb's crook free of folds in this pose, which no scan
    # of the learned hand's training showed.
    model = open_model("start_hand")
    pose = torch.zeros(1, len(model.joint_names), 3, dtype=torch.float64)
    for joint, turn in turns.items():
        pose[0, model.joint_names.index(joint)] = torch.tensor(turn, dtype=torch.float64)
    shape = torch.zeros(1, model.shape_directions.shape[2], dtype=torch.float64)
    labels = np.full(model.vertex_count, -1)
    for label, members in enumerate(model.parts.values()):
        labels[members] = label
    vertices = model(shape=shape, pose=FullPose(pose)).vertices[0].numpy()
    assert part_penetration(vertices, model.faces, labels).deepest == 0


def test_a_negative_label_takes_no_part() -> None:
    vertices, faces, labels = blocky_hand()
    vertices[labels == 2] += [7 * MILLIMETRE, 0, 0]
    assert part_penetration(vertices, faces, np.where(labels == 3, -1, labels)).deepest == 0
