"""Which registrations of a held-out session are scored, and which make the personal templates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from corporeal.learning.personal import personal_model, personal_template
from corporeal.learning.training_set import LearningError, TrainingSet
from corporeal.model.surface_model import SurfaceModel

MOST_SCORED = 50
"""As many scans as the paper scores."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A held-out session.

    Attributes:
        registrations: accepted ones, of one side.
        scored: indices of those whose scans are scored, sorted.
        kept: indices of those that personal templates are made of: all that are not of a scored scan.
        notes: what a reader of the figures must know of the choice.
    """

    registrations: TrainingSet
    scored: Int[np.ndarray, " n"]
    kept: Int[np.ndarray, " m"]
    notes: tuple[str, ...]

    @property
    def hands(self) -> tuple[str, ...]:
        """Names of the hands that are scored."""
        return tuple(sorted({self.registrations.hands[index] for index in self.scored}))


def held_out(registrations: TrainingSet, protocol_pose: str, most: int = MOST_SCORED) -> HeldOut:
    """Choose what is scored: up to so many scans of one protocol pose, as evenly over subjects as there are.

    The choice follows names alone and repeats. Hands without another registration are not scored: they would
    have no personal template, or one made of the scan that it is judged by.

    Args:
        registrations: accepted ones of the session.
        protocol_pose: that is scored: one that no training session holds.
        most: scans.

    Raises:
        LearningError: nothing to score.
    """
    asked = np.array([pose == protocol_pose for pose in registrations.protocol_poses])
    with_others = {hand for hand, pose in zip(registrations.hands, asked, strict=True) if not pose}
    by_subject: dict[str, list[int]] = {}
    for index in np.argsort(np.array(registrations.names, dtype=np.str_), kind="stable"):
        if asked[index] and registrations.hands[index] in with_others:
            by_subject.setdefault(registrations.subjects[index], []).append(int(index))
    if not by_subject:
        poses = sorted(set(registrations.protocol_poses))
        raise LearningError(
            f"no accepted registration has the protocol pose {protocol_pose!r} and another one of its hand; "
            f"the session has {', '.join(poses[:5])}; simulate more with --natural-share"
        )
    scored = _in_turns(by_subject, most)
    people = len({registrations.subjects[index] for index in scored})
    kept = np.setdiff1d(np.arange(len(registrations)), scored)
    notes = [
        f"{len(scored)} scans of the pose {protocol_pose!r} of {people} subjects are scored; "
        "personal templates are made of other scans"
    ]
    if len(scored) < most:
        notes.append(f"{most} scans were asked for: the session holds no more that are accepted")
    alone = sorted(
        {hand for hand, pose in zip(registrations.hands, asked, strict=True) if pose} - with_others
    )
    if alone:
        notes.append(f"not scored, since all accepted scans show this pose: {', '.join(alone)}")
    return HeldOut(registrations, scored, kept, tuple(notes))


def personal_models(model: SurfaceModel, session: HeldOut) -> dict[str, SurfaceModel]:
    """Hand -> the model around the hand's own template, made with this model's weights and correctives."""
    models = {}
    for hand in session.hands:
        chosen = [index for index in session.kept if session.registrations.hands[index] == hand]
        own = session.registrations.subset(np.array(chosen))
        found = personal_template(model, own.vertices, own.poses, own.translations)
        models[hand] = personal_model(model, found.template)
    return models


def _in_turns(by_subject: dict[str, list[int]], most: int) -> Int[np.ndarray, " n"]:
    """One of each subject after the other, until there are enough."""
    longest = max(len(indices) for indices in by_subject.values())
    in_turns = [
        by_subject[subject][turn]
        for turn in range(longest)
        for subject in sorted(by_subject)
        if turn < len(by_subject[subject])
    ]
    return np.sort(np.array(in_turns[:most]))
