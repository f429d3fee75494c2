"""A virtual capture session: who does which pose with which hand, and each of its scans with the truth."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from jaxtyping import Float, Int, UInt8
from scipy.spatial.transform import Rotation

from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.subdivision import LoopStep, loop_step
from corporeal.scans.simulation.appearance import skin_colours
from corporeal.scans.simulation.faults import Fault, choose_fault, spoil
from corporeal.scans.simulation.files import HandSimulator, load_simulator
from corporeal.scans.simulation.hand_flesh import HAND, SoftHand
from corporeal.scans.simulation.identities import Side, Subject, hand_at_rest, sample_subjects
from corporeal.scans.simulation.props import hand_stand, held_object
from corporeal.scans.simulation.protocol import HandPose, natural_pose, performed, protocol_poses, subset_for
from corporeal.scans.simulation.sampling_pattern import SamplingPattern, sampling_pattern
from corporeal.scans.simulation.scanner import SampledSurface, ScannerOptions, scan_surface

NATURAL_SHARE = 0.15
_NATURAL = "natural"
_MM = 1e3
# Asked for on the whole skin; a scan sees some 45,000 to 50,000 of them.
_POINTS = 60_000
# How the arm lies in the scanner: fingers up, then turned at will within these degrees.
_UPRIGHT = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
_TURN_ABOUT_ARM, _TILT = 60.0, 20.0


@dataclass(frozen=True)
class SimulationOptions:
    """What a session holds.

    Attributes:
        subjects: people.
        poses: how many of the protocol's poses are used; every hand does about five eighths of them.
        seed: everything follows from it.
        sides: which hands.
        objects: put green objects into grasps.
        bad_one_in: one scan in so many is spoilt on purpose; 0 for none.
        natural_share: share of a hand's scans that show a pose of no protocol, between recorded ones.
    """

    subjects: int = 31
    poses: int = 51
    seed: int = 0
    sides: Literal["both", "right", "left"] = "both"
    objects: bool = False
    bad_one_in: int = 40
    natural_share: float = NATURAL_SHARE


@dataclass(frozen=True)
class PlannedScan:
    """One scan to be made: name, subject's number, protocol pose, side and the fault made on purpose."""

    name: str
    subject: int
    side: Side
    protocol_pose: str
    fault: Fault


@dataclass(frozen=True, eq=False)
class ScanTruth:
    """What registration never reads; metres, in the scan's frame.

    Attributes:
        template: (P, 3) true position of every vertex of the open hand's template, of the mirrored one for a
            left hand.
        joints: (16, 3) wrist, then index, middle, little, ring, thumb.
        angles: (17, 3) degrees: flexion, spread, twist of every bone that the hand reached.
        fault: what was spoilt on purpose, or "".
        pose_share: how much of the performed pose the flesh reached.
        volume_ratio: volume against rest.
        smallest_det: smallest determinant of a deformation gradient.
        deepest: how deep skin stands in other skin, metres.
    """

    template: Float[np.ndarray, "P 3"]
    joints: Float[np.ndarray, "16 3"]
    angles: Float[np.ndarray, "17 3"]
    fault: str
    pose_share: float
    volume_ratio: float
    smallest_det: float
    deepest: float


@dataclass(frozen=True, eq=False)
class SimulatedScan:
    """Points (N, 3) in millimetres, faces (M, 3), colours (N, 3), and the truth."""

    points_mm: Float[np.ndarray, "N 3"]
    faces: Int[np.ndarray, "M 3"]
    colours: UInt8[np.ndarray, "N 3"]
    truth: ScanTruth


def plan_session(options: SimulationOptions) -> tuple[PlannedScan, ...]:
    """All scans of a session, subject by subject and hand by hand."""
    sides: tuple[Side, ...] = ("right", "left") if options.sides == "both" else (options.sides,)
    poses = protocol_poses()[: options.poses]
    planned = []
    for number in range(options.subjects):
        for side in sides:
            generator = np.random.default_rng([options.seed, 2, number, side == "left"])
            for index in subset_for(len(poses), generator):
                natural = generator.random() < options.natural_share
                name = f"s{number + 1:02d}_p{index + 1:02d}_{side}"
                pose = _NATURAL if natural else poses[index].name
                fault = choose_fault(name, options.seed, options.bad_one_in) if options.bad_one_in else ""
                planned.append(PlannedScan(name, number, side, pose, fault))
    return tuple(planned)


def subjects_of(options: SimulationOptions) -> tuple[Subject, ...]:
    """The people of a session."""
    return sample_subjects(load_simulator(), options.subjects, options.seed)


def true_hand(options: SimulationOptions, number: int, side: Side) -> SoftHand:
    """The soft hand of a session's person, number 0 being the first; a left one as its mirror image."""
    return _hand_of(options.subjects, options.seed, number, side)[1]


def embedded(surface: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "P 3"]:
    """Where the vertices of the open hand's template lie on the simulator's skin."""
    return _on_fine(_fine(load_simulator())(surface))


def simulate_scan(planned: PlannedScan, options: SimulationOptions) -> SimulatedScan:
    """Make one scan; the same plan and options give the same numbers."""
    simulator = load_simulator()
    generator = np.random.default_rng([options.seed, 3, zlib.crc32(planned.name.encode())])
    pose = _performed_pose(planned, generator)
    person, hand = _hand_of(options.subjects, options.seed, planned.subject, planned.side)
    posed = hand.posed(pose.angles)
    fine = _fine(simulator)
    surface, rest = fine(posed.surface), fine(hand.rest_surface)
    joints = np.einsum("kab,kb->ka", posed.motions[:, :3, :3], hand.joints[:17]) + posed.motions[:, :3, 3]
    T_scanner_hand = _placement(joints[HAND], planned.side, generator)
    left = planned.side == "left"
    faces = fine.faces[:, [0, 2, 1]] if left else fine.faces
    surface, joints = _moved(surface, T_scanner_hand), _moved(joints, T_scanner_hand)
    colours = skin_colours(rest, vertex_normals(rest, fine.faces), person.tone, person.seed)
    pattern = _pattern(options.seed)
    props = [hand_stand(joints[0], joints[HAND])]
    if options.objects and pose.group == "grasp":
        held = held_object(surface, joints, generator)
        props += [] if held is None else [held]
    hand_surface = SampledSurface(surface, faces, colours, pattern.mirrored() if left else pattern)
    capture = scan_surface(hand_surface, props, ScannerOptions(), generator)
    capture = spoil(capture, planned.fault, generator)
    rest_angles = simulator.rest_angles
    truth = ScanTruth(
        template=_on_fine(surface),
        joints=joints[1:],
        angles=rest_angles + posed.pose_share * (pose.angles - rest_angles),
        fault=planned.fault,
        pose_share=posed.pose_share,
        volume_ratio=posed.flesh.volume_ratio,
        smallest_det=posed.flesh.smallest_det,
        deepest=posed.flesh.deepest,
    )
    return SimulatedScan(_MM * capture.points, capture.faces, capture.colours, truth)


def _performed_pose(planned: PlannedScan, generator: np.random.Generator) -> HandPose:
    if planned.protocol_pose == _NATURAL:
        return natural_pose(generator)
    pose = next(pose for pose in protocol_poses() if pose.name == planned.protocol_pose)
    return performed(pose, generator)


@lru_cache(maxsize=2)
def _hand_of(count: int, seed: int, number: int, side: Side) -> tuple[Subject, SoftHand]:
    """The person's soft hand; kept, because a session goes through a person's poses one after the other."""
    simulator = load_simulator()
    subject = sample_subjects(simulator, count, seed)[number]
    return subject, SoftHand(simulator, *hand_at_rest(simulator, subject, side))


def _on_fine(surface: np.ndarray) -> Float[np.ndarray, "P 3"]:
    """The template's vertices on a skin that has been refined by one Loop step."""
    simulator = load_simulator()
    corners = surface[_fine(simulator).faces[simulator.template_faces]]
    return np.einsum("pc,pca->pa", simulator.template_barycentric, corners)


@lru_cache(maxsize=1)
def _fine(simulator: HandSimulator) -> LoopStep:
    return loop_step(simulator.surface_faces, len(simulator.surface_vertices))


@lru_cache(maxsize=1)
def _pattern(seed: int) -> SamplingPattern:
    """Where points fall on the skin; each scan moves them and shuffles their order."""
    simulator = load_simulator()
    fine = _fine(simulator)
    generator = np.random.default_rng([seed, 5])
    return sampling_pattern(fine(simulator.surface_vertices), fine.faces, _POINTS, generator)


def _placement(wrist: np.ndarray, side: Side, generator: np.random.Generator) -> Float[np.ndarray, "4 4"]:
    """From the hand's frame to the scanner's: arm upright, turned at will; left hands mirrored."""
    about = generator.uniform(-_TURN_ABOUT_ARM, _TURN_ABOUT_ARM)
    tilt = generator.uniform(-_TILT, _TILT, size=2)
    R = Rotation.from_euler("xyz", [*tilt, about], degrees=True).as_matrix() @ _UPRIGHT
    if side == "left":
        R = R @ np.diag([1.0, 1.0, -1.0])
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = generator.normal(scale=0.02, size=3) - R @ wrist
    return T


def _moved(points: np.ndarray, T: np.ndarray) -> np.ndarray:
    return points @ T[:3, :3].T + T[:3, 3]
