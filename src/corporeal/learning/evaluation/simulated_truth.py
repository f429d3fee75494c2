"""The truth of a simulated session in a learned model's terms: pose, template and joints at its zero pose.

The simulator knows no zero pose of the model: learning puts every joint's zero where it explains the
registrations best. Which turn of every bone that is, the learned personal templates tell.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from corporeal.geometry.rotations_numeric import axis_angle_from_matrix
from corporeal.learning.evaluation.alignment import rigid_onto
from corporeal.learning.evaluation.results import TruthResult
from corporeal.learning.evaluation.truth import compare_with_truth
from corporeal.learning.personal import personal_model
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.simulation.files import load_simulator
from corporeal.scans.simulation.hand_flesh import SoftHand
from corporeal.scans.simulation.simulate import (
    PlannedScan,
    ScanTruth,
    SimulationOptions,
    embedded,
    plan_session,
    subjects_of,
    true_hand,
)
from corporeal.scans.simulation.skeleton import angles_of_turns, bone_transforms, turns

FLEXED = 30.0
"""Degrees: in a flexed pose the joints of index, middle, little and ring are bent so far in the mean."""
LEAST_R_SQUARED = 0.6
_FINGERS = slice(2, 14)
_FLEXION = 0
# Vertices that follow one bone alone so far tell how it is turned.
_RIGID_WEIGHT = 0.7
_FEWEST_RIGID = 3
# Skin turns less than the bone in it, least when the bone twists: one pass left up to 4 of 8 degrees.
_PASSES = 4


@dataclass(frozen=True, eq=False)
class TrueScan:
    """A simulated scan's truth, and whose hand it is ("s01/right")."""

    planned: PlannedScan
    hand: str
    truth: ScanTruth


@dataclass(frozen=True, eq=False)
class ZeroPose:
    """The model's zero pose in the simulator's terms.

    Attributes:
        R_model_simulator: from the simulator's frame of a hand to the model's.
        turns: (16, 3, 3) of hand and finger bones from the flat hand to the zero pose, in the simulator's
            frame; the hand itself stays.
    """

    R_model_simulator: Float[np.ndarray, "3 3"]
    turns: Float[np.ndarray, "16 3 3"]


@dataclass(frozen=True, eq=False)
class TrueTemplate:
    """A true hand settled at the model's zero pose.

    Attributes:
        vertices: (V, 3) metres, in the model's frame.
        joints: (16, 3) the same.
        motions: (17, 4, 4) of the bones from rest, in the simulator's frame.
        hand: that was settled.
    """

    vertices: Float[np.ndarray, "V 3"]
    joints: Float[np.ndarray, "16 3"]
    motions: Float[np.ndarray, "17 4 4"]
    hand: SoftHand


@dataclass(frozen=True, eq=False)
class PosedTruth:
    """A true pose: axis-angle (16, 3) and translation for the model, and how its frame lies in the scan."""

    pose: Float[np.ndarray, "16 3"]
    translation: Float[np.ndarray, "3"]
    R_scan_model: Float[np.ndarray, "3 3"]
    t_scan_model: Float[np.ndarray, "3"]

    def in_model(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
        """Points of the scan's frame in the model's, metres."""
        return (points - self.t_scan_model) @ self.R_scan_model


def planned_scans(options: SimulationOptions) -> dict[str, tuple[PlannedScan, str]]:
    """Name of every scan of a session -> its plan, and whose hand it shows."""
    subjects = subjects_of(options)
    return {scan.name: (scan, f"{subjects[scan.subject].name}/{scan.side}") for scan in plan_session(options)}


def flexed(scans: Sequence[TrueScan], most: int) -> tuple[TrueScan, ...]:
    """The scans whose fingers are bent by more than ``FLEXED``, at most so many, spread over the list."""
    bent = [scan for scan in scans if scan.truth.angles[_FINGERS, _FLEXION].mean() > FLEXED]
    if len(bent) <= most:
        return tuple(bent)
    return tuple(bent[index] for index in np.linspace(0, len(bent) - 1, most).round().astype(int))


def zero_pose(
    model: SurfaceModel,
    templates: Mapping[str, Float[np.ndarray, "V 3"]],
    scans: Sequence[TrueScan],
    options: SimulationOptions,
) -> ZeroPose:
    """How the zero pose of a model turns every bone of the simulator's flat hand, in the mean over hands.

    The turn of a bone is that of the vertices which follow it nearly alone: the hands are settled where the
    turns are so far, and turned on by what is left between them and the templates.

    Args:
        model: learned, of the right hand.
        templates: hand -> its personal template at the model's zero pose, metres.
        scans: of all these hands.
        options: of the session.

    Raises:
        ValueError: a joint that fewer than three vertices follow alone.
    """
    rigid = [np.flatnonzero(column > _RIGID_WEIGHT) for column in model.skinning_weights.T]
    for name, vertices in zip(model.joint_names, rigid, strict=True):
        if len(vertices) < _FEWEST_RIGID:
            raise ValueError(
                f"skinning_weights: {len(vertices)} vertices follow {name!r} alone, expected three"
            )
    whose = {scan.hand: scan.planned for scan in scans}
    hands = [(name, true_hand(options, one.subject, one.side)) for name, one in whose.items()]
    zero = ZeroPose(np.eye(3), np.tile(np.eye(3), (model.joint_count, 1, 1)))
    for _ in range(_PASSES):
        frames, residual = [], []
        for name, hand in hands:
            settled = true_template(hand, zero).vertices @ zero.R_model_simulator
            found = [rigid_onto(settled[vertices], templates[name][vertices])[0] for vertices in rigid]
            frames.append(found[0])
            residual.append(found[0].T @ np.stack(found))
        zero = ZeroPose(
            _mean(frames), np.stack([_mean(bone) for bone in zip(*residual, strict=True)]) @ zero.turns
        )
    return zero


def true_template(hand: SoftHand, zero: ZeroPose) -> TrueTemplate:
    """A true hand settled at the model's zero pose."""
    simulator = load_simulator()
    world = bone_transforms(simulator, hand.joints, np.zeros((17, 3)))[:, :3, :3]
    world[1:] = zero.turns @ world[1:]
    rest = turns(simulator.rest_angles, simulator.axes)
    settled = hand.posed(angles_of_turns(rest @ _relative(world, simulator.parents), simulator.axes))
    R = zero.R_model_simulator
    joints = _moved(hand.joints[:17], settled.motions)
    return TrueTemplate(embedded(settled.surface) @ R.T, joints[1:] @ R.T, settled.motions, hand)


def true_pose(
    template: TrueTemplate, truth: ScanTruth, model_joints: np.ndarray, zero: ZeroPose
) -> PosedTruth:
    """The pose of a scan as the model turns its joints, and the way into the scan.

    Args:
        template: of the hand.
        truth: of a scan of it.
        model_joints: (16, 3) where the model has its joints in the template: its hand moves as the true
            one, which places the root.
        zero: of the model.
    """
    simulator, hand, R = load_simulator(), template.hand, zero.R_model_simulator
    posed = bone_transforms(simulator, hand.joints, truth.angles)
    since_zero = posed @ np.linalg.inv(template.motions)
    local = _relative(since_zero[:, :3, :3], simulator.parents)[1:]
    root = model_joints[0] @ R
    moved = (since_zero[1, :3, :3] @ root + since_zero[1, :3, 3]) @ R.T
    joints = _moved(hand.joints[:17], posed)[1:] @ R.T
    R_scan, t_scan = rigid_onto(joints, truth.joints)
    return PosedTruth(axis_angle_from_matrix(R @ local @ R.T), moved - model_joints[0], R_scan, t_scan)


def against_simulation(
    label: str,
    model: SurfaceModel,
    templates: Mapping[str, Float[np.ndarray, "V 3"]],
    scans: Sequence[TrueScan],
    options: SimulationOptions,
) -> TruthResult:
    """The model at true poses with true templates against the true surfaces, correctives on and off.

    Args:
        label: of the model.
        model: learned, of the right hand, with correctives.
        templates: hand -> its personal template, from which its zero pose is told.
        scans: of right hands.
        options: of the session.

    Raises:
        ValueError: no scan, a left hand, or a model of another template than the simulator's.
    """
    if not scans or any(scan.planned.side != "right" for scan in scans) or model.side != "right":
        raise ValueError("scans: expected some of right hands, and a model of the right hand")
    if model.template.shape != scans[0].truth.template.shape or model.joint_count != len(
        scans[0].truth.joints
    ):
        raise ValueError(f"model: {model.name!r} has not the template whose truth is known")
    zero = zero_pose(model, templates, scans, options)
    by_hand: dict[str, list[TrueScan]] = {}
    for scan in scans:
        by_hand.setdefault(scan.hand, []).append(scan)
    found = [posed for own in by_hand.values() for posed in _posed_scans(model, own, zero, options)]
    surfaces, without, truth, centres, true_centres = (
        np.stack(arrays) for arrays in zip(*found, strict=True)
    )
    return compare_with_truth(
        label, surfaces, without, truth, joints=(centres, true_centres), limit=LEAST_R_SQUARED
    )


def surfaces_at_true_poses(
    model: SurfaceModel, template: TrueTemplate, scans: Sequence[TrueScan], zero: ZeroPose
) -> list[tuple[Float[np.ndarray, "V 3"], ...]]:
    """Of every scan of a hand: the model's surface with correctives, without, and the true one, metres.

    Args:
        model: with the true template, and joints of its own.
        template: of the hand.
        scans: of it.
        zero: of the model.
    """
    centres = np.asarray(model.joint_regressor @ model.template)
    found: list[tuple[np.ndarray, ...]] = []
    for scan in scans:
        true = true_pose(template, scan.truth, centres, zero)
        with_them, without = (
            evaluate(model, np.zeros(0), true.pose, true.translation, correctives=correctives).vertices
            @ true.R_scan_model.T
            + true.t_scan_model
            for correctives in (True, False)
        )
        found.append((with_them, without, scan.truth.template))
    return found


def _posed_scans(
    model: SurfaceModel, scans: Sequence[TrueScan], zero: ZeroPose, options: SimulationOptions
) -> list[tuple[np.ndarray, ...]]:
    """Of every scan of a hand: surfaces with and without correctives, the true one; joints, the true ones."""
    planned = scans[0].planned
    template = true_template(true_hand(options, planned.subject, planned.side), zero)
    personal = personal_model(model, template.vertices)
    centres = np.asarray(personal.joint_regressor @ personal.template)
    surfaces = surfaces_at_true_poses(personal, template, scans, zero)
    return [(*of_scan, centres, template.joints) for of_scan in surfaces]


def _relative(rotations: Float[np.ndarray, "17 3 3"], parents: np.ndarray) -> Float[np.ndarray, "17 3 3"]:
    """Of every bone against its parent."""
    above = np.where((parents >= 0)[:, None, None], rotations[parents], np.eye(3))
    return above.transpose(0, 2, 1) @ rotations


def _mean(rotations: Sequence[np.ndarray]) -> Float[np.ndarray, "3 3"]:
    return Rotation.from_matrix(np.stack(rotations)).mean().as_matrix()


def _moved(points: np.ndarray, motions: Float[np.ndarray, "n 4 4"]) -> Float[np.ndarray, "n 3"]:
    return np.einsum("kab,kb->ka", motions[:, :3, :3], points) + motions[:, :3, 3]
