"""What learning reads: accepted registrations of many hands, all turned into one side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float, Int

from corporeal.model.mirror import mirror_translation
from corporeal.model.surface_model import SurfaceModel
from corporeal.registration.session.records import SessionRecord

# M R M of an axis-angle (supplement of Romero et al. 2017, section 1).
_MIRRORED_AXIS = np.array([1.0, -1.0, -1.0])


class LearningError(ValueError):
    """Nothing can be learned from what was given; the message says why and what to do."""


@dataclass(frozen=True, eq=False)
class TrainingSet:
    """N registrations with one template, all of one side.

    Attributes:
        vertices: (N, V, 3) registrations, metres.
        poses: (N, K, 3) axis-angle where the fitted model stood, radians: where learning starts from.
        translations: (N, 3) the same, metres.
        shapes: (N, S) the same: shape coefficients.
        hands: N names of whose hand it is, for instance "s01/left": one personal template each.
        subjects: N names of people.
        protocol_poses: N names of the poses that were asked for; "" where that is not known.
        names: N names of scans.
    """

    vertices: Float[np.ndarray, "N V 3"]
    poses: Float[np.ndarray, "N K 3"]
    translations: Float[np.ndarray, "N 3"]
    shapes: Float[np.ndarray, "N S"]
    hands: tuple[str, ...]
    subjects: tuple[str, ...]
    protocol_poses: tuple[str, ...]
    names: tuple[str, ...]

    def __post_init__(self) -> None:
        for field in fields(self):
            if len(getattr(self, field.name)) != len(self.names):
                raise ValueError(
                    f"{field.name}: {len(getattr(self, field.name))} entries, {len(self.names)} registrations"
                )

    def __len__(self) -> int:
        return len(self.names)

    def subset(self, keep: Int[np.ndarray, " n"] | Bool[np.ndarray, " N"]) -> TrainingSet:
        """The registrations of these indices, or those that are marked."""
        chosen = np.flatnonzero(keep) if keep.dtype == bool else keep

        def picked(words: tuple[str, ...]) -> tuple[str, ...]:
            return tuple(words[index] for index in chosen)

        return TrainingSet(
            self.vertices[chosen], self.poses[chosen], self.translations[chosen], self.shapes[chosen],
            picked(self.hands), picked(self.subjects), picked(self.protocol_poses), picked(self.names),
        )  # fmt: skip

    def joined(self, other: TrainingSet) -> TrainingSet:
        """Both together."""
        arrays = [
            np.concatenate([getattr(self, name), getattr(other, name)])
            for name in ("vertices", "poses", "translations", "shapes")
        ]
        words = [
            getattr(self, name) + getattr(other, name)
            for name in ("hands", "subjects", "protocol_poses", "names")
        ]
        return TrainingSet(*arrays, *words)


def training_set(
    records: Sequence[SessionRecord], model: SurfaceModel, decisions: Mapping[str, str] | None = None
) -> TrainingSet:
    """The accepted registrations of a session.

    Accepted is what the curator accepted, and of what he did not decide, what has the status "ok".
    Registrations of the other side than the model's are mirrored in (supplement of Romero et al. 2017,
    section 1).

    Args:
        records: of a registered session.
        model: whose template was registered; of either side.
        decisions: name of a scan -> "accept" or "reject".

    Raises:
        LearningError: nothing is accepted, a registration has another number of vertices or joints than the
        model, or
            numbers that are not finite; the message names it.
    """
    decisions = decisions or {}
    accepted = [record for record in records if _accepted(record, decisions)]
    if not accepted:
        raise LearningError(
            f"none of {len(records)} registrations is accepted; curate them, or register better scans"
        )
    for record in accepted:
        _check(record, model)
    sides = [record.side for record in accepted]
    turned = [side is not None and side != model.side for side in sides]
    people = tuple(str(record.row.get("subject") or record.name) for record in accepted)
    shapes = np.zeros((len(accepted), max(len(_given(record.shape)) for record in accepted)))
    for row, record in zip(shapes, accepted, strict=True):
        row[: len(_given(record.shape))] = record.shape
    return TrainingSet(
        vertices=np.stack(
            [_side_of(record.vertices, flip) for record, flip in zip(accepted, turned, strict=True)]
        ),
        poses=np.stack(
            [
                _given(record.pose) * (_MIRRORED_AXIS if flip else 1.0)
                for record, flip in zip(accepted, turned, strict=True)
            ]
        ).astype(np.float64),
        translations=np.stack(
            [_side_of(record.translation, flip) for record, flip in zip(accepted, turned, strict=True)]
        ),
        shapes=shapes,
        hands=tuple(
            person if side is None else f"{person}/{side}" for person, side in zip(people, sides, strict=True)
        ),
        subjects=people,
        protocol_poses=tuple(str(record.row.get("protocol_pose") or "") for record in accepted),
        names=tuple(record.name for record in accepted),
    )


def _accepted(record: SessionRecord, decisions: Mapping[str, str]) -> bool:
    decision = decisions.get(record.name, "accept" if record.row["status"] == "ok" else "reject")
    return record.is_registered and decision == "accept"


def _check(record: SessionRecord, model: SurfaceModel) -> None:
    vertices, pose = _given(record.vertices), _given(record.pose)
    if vertices.shape != (model.vertex_count, 3) or pose.shape != (model.joint_count, 3):
        raise LearningError(
            f"{record.name}: a registration of {len(vertices)} vertices and {len(pose)} joints, but the "
            f"start model {model.name!r} has {model.vertex_count} and {model.joint_count}; give the model "
            "that it was registered with"
        )
    if not all(np.isfinite(array).all() for array in (vertices, pose, _given(record.translation))):
        raise LearningError(
            f"{record.name}: coordinates that are not finite; reject it, or register it again"
        )


def _given(array: np.ndarray | None) -> np.ndarray:
    if array is None:
        raise LearningError("a record without vertices, pose, shape and translation was accepted; reject it")
    return array


def _side_of(points: np.ndarray | None, flip: bool) -> np.ndarray:
    return mirror_translation(_given(points)) if flip else _given(points)
