"""How much of the flesh pose correctives could explain, were nothing else unknown.

``corporeal evaluate`` gives a learned model the true poses and templates of a simulation and asks how much of
what linear skinning misses its correctives explain (R^2). What it finds mixes three things: what correctives
of this form can say, joints that learning could not see in skin, and registrations that slide along the skin.
Here correctives and weights are learned from the truth itself: true surfaces, joints, poses and templates of
the training session. Its R^2 on the test session is the first of the three alone.

    python benchmarks/correctives_ceiling.py TRAIN_REG TEST_REG [--start start_hand] [--most 450]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from corporeal.cli.named_models import named_model
from corporeal.cli.registered_session import RegisteredSession, read_registered, true_scans
from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.geometry.topology import unique_edges
from corporeal.learning.correctives import fit_correctives
from corporeal.learning.evaluation.simulated_truth import (
    TrueScan,
    ZeroPose,
    flexed,
    true_pose,
    true_template,
)
from corporeal.learning.joint_distances import geodesic_joint_distances
from corporeal.learning.objective import Priors
from corporeal.learning.options import LearningOptions
from corporeal.learning.state import LearningState, Registrations
from corporeal.learning.weights import fit_weights, weight_candidates
from corporeal.model.surface_model import SurfaceModel
from corporeal.scans.simulation.simulate import SimulationOptions, true_hand

SWEEPS = 3


def truth_of(
    session: RegisteredSession, scans: Sequence[TrueScan], model: SurfaceModel
) -> tuple[LearningState, Registrations]:
    """True surfaces as registrations, and a state in which all but weights and correctives is true."""
    options: SimulationOptions | None = session.simulation
    if options is None or not scans:
        raise SystemExit(f"{session.folder}: no truth; give registrations of a simulated session")
    flat = ZeroPose(np.eye(3), np.tile(np.eye(3), (model.joint_count, 1, 1)))
    hands = sorted({scan.hand for scan in scans})
    first = {scan.hand: scan.planned for scan in reversed(scans)}
    settled = [true_template(true_hand(options, first[h].subject, first[h].side), flat) for h in hands]
    index = np.array([hands.index(scan.hand) for scan in scans])
    posed = [
        true_pose(settled[i], scan.truth, settled[i].joints, flat)
        for i, scan in zip(index, scans, strict=True)
    ]
    surfaces = [own.in_model(scan.truth.template) for scan, own in zip(scans, posed, strict=True)]
    K, V = model.joint_count, model.vertex_count
    poses = np.concatenate([own.pose for own in posed])
    state = LearningState(
        templates=np.stack([hand.vertices for hand in settled]),
        joints=np.stack([hand.joints for hand in settled]),
        weights=np.asarray(model.skinning_weights, dtype=np.float64),
        pose_directions=np.zeros((9 * (K - 1), 3 * V)),
        regressor=model.joint_regressor,
        rotations=matrix_from_axis_angle(poses).reshape(len(scans), K, 3, 3),
        translations=np.stack([own.translation for own in posed]),
        parents=model.parents,
    )
    return state, Registrations(np.stack(surfaces), index, np.ones(len(scans)))


def print_row(label: str, learned: LearningState, state: LearningState, data: Registrations) -> None:
    """R^2 and root mean square errors with the learned weights, correctives on and off."""
    errors = []
    for directions in (learned.pose_directions, np.zeros_like(learned.pose_directions)):
        used = LearningState(**{**vars(state), "weights": learned.weights, "pose_directions": directions})
        errors.append(used.squared_errors(data).sum())
    millimetres = [1e3 * np.sqrt(error / data.vertices[..., 0].size) for error in errors]
    print(
        f"{label:22s} {len(data.hands):5d} scans  R^2 {1 - errors[0] / errors[1]:.3f}  "
        f"rms {millimetres[0]:.2f} mm, without correctives {millimetres[1]:.2f} mm"
    )


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("train", type=Path)
    parser.add_argument("test", type=Path)
    parser.add_argument("--start", default="start_hand")
    parser.add_argument("--most", type=int, default=450, help="training scans")
    options = parser.parse_args()
    model, learning = named_model(Path(options.start)), LearningOptions()
    train, test = (read_registered(folder, model) for folder in (options.train, options.test))
    seen = true_scans(train, set(train.registrations.hands))
    seen = [seen[i] for i in np.unique(np.linspace(0, len(seen) - 1, options.most).round().astype(int))]
    state, data = truth_of(train, seen, model)
    distances = geodesic_joint_distances(model.template, model.faces, model.joint_regressor)[1:]
    held = np.tile(learning.joint_strength * np.eye(3), (len(state.templates), model.joint_count, 1, 1))
    priors = Priors(state.templates, state.weights, held, distances)
    candidates = weight_candidates(state.weights, unique_edges(model.faces))
    for _ in range(SWEEPS):
        state = fit_weights(
            fit_correctives(state, data, priors, learning), data, priors, learning, candidates
        )
    state = fit_correctives(state, data, priors, learning)
    bent = flexed(true_scans(test, set(test.registrations.hands)), 1000)
    print_row("training", state, state, data)
    print_row("held out, flexed", state, *truth_of(test, bent, model))


if __name__ == "__main__":
    main()
