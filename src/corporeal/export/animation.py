"""A tracked sequence as one animated GLB file: skin, joint motion, and weights of few corrective targets."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from corporeal.atomic import write_bytes
from corporeal.export.gltf_morphs import MorphTargets
from corporeal.export.gltf_scene import AnimatedModel, few_joints, glb_bytes
from corporeal.export.principal_correctives import principal_correctives
from corporeal.model.surface_model import SurfaceModel


@dataclass(frozen=True)
class AnimationOptions:
    """How a sequence is put into a file.

    Attributes:
        most_targets: corrective targets at most; one per pose feature would be 486 for a body.
        tolerance: the fewest targets are taken that leave no vertex farther than this from its place, metres.
        most_joints: that move one vertex; viewers read four.
        colour: linear red, green, blue of the material, 0..1.
    """

    most_targets: int = 24
    tolerance: float = 0.5e-3
    most_joints: int = 4
    colour: tuple[float, float, float] = (0.60, 0.38, 0.29)


@dataclass(frozen=True)
class AnimationSummary:
    """What a file holds and what it leaves out; it stands in the file's ``asset.extras`` too.

    Attributes:
        keys: of the animation, one per frame.
        fps: keys per second.
        corrective_targets: how many.
        largest_corrective_error_mm: of a vertex at a key by the correctives that are left out.
        largest_corrective_mm: the largest corrective of the sequence, to compare with.
        largest_joint_share_lost: skinning weight of joints beyond the most that a vertex may have.
        bytes: of the file.
    """

    keys: int
    fps: float
    corrective_targets: int
    largest_corrective_error_mm: float
    largest_corrective_mm: float
    largest_joint_share_lost: float
    bytes: int = 0


def write_animation(
    path: Path | str, model: SurfaceModel, shape: Float[np.ndarray, " s"],
    poses: Float[np.ndarray, "n joints 3"], translations: Float[np.ndarray, "m 3"], fps: float,
    options: AnimationOptions | None = None,
) -> AnimationSummary:  # fmt: skip
    """Write a sequence, one key per frame; it opens in its first frame.

    Joint rotations, the root's place and the targets' weights have a key per frame; between keys rotations
    turn along the shortest arc and the others go in a straight line, as glTF has it.

    Args:
        path: the file; its folder is made if it is missing.
        model: the subject's model, or any other.
        shape: coefficients of its first shape directions; baked in.
        poses: axis-angle of all joints per frame, radians.
        translations: metres per frame.
        fps: frames per second.
        options: how.

    Raises:
        ValueError: arguments that do not fit the model or are not finite.
        OSError: the file cannot be written.
    """
    options = options or AnimationOptions()
    _check(model, shape, poses, translations, fps)
    rest = model.template + model.shape_directions[:, :, : len(shape)] @ shape
    found = principal_correctives(model, poses, most=options.most_targets, tolerance=options.tolerance)
    targets = found.targets
    lost = np.abs(
        few_joints(model.skinning_weights, options.most_joints) - few_joints(model.skinning_weights, None)
    ).max()
    summary = AnimationSummary(
        len(poses),
        float(fps),
        len(targets.names),
        found.largest_error_mm,
        found.largest_without_mm,
        float(lost),
    )
    # A single key has no length; viewers want two.
    held = len(poses) == 1
    keys = np.array([0, 0]) if held else np.arange(len(poses))
    scene = AnimatedModel(
        model=model,
        rest=rest,
        base=rest,
        targets=MorphTargets(targets.names, targets.displacements, targets.weights[keys]),
        poses=poses[keys],
        translations=translations[keys],
        times=np.arange(len(keys)) / fps,
        opened=0,
    )
    extras = {name: value for name, value in asdict(summary).items() if name != "bytes"}
    content = glb_bytes(
        scene,
        animation="track",
        colour=options.colour,
        most_joints=options.most_joints,
        extras={"corporeal": extras},
    )
    write_bytes(path, content)
    return AnimationSummary(**(asdict(summary) | {"bytes": len(content)}))


def _check(
    model: SurfaceModel, shape: np.ndarray, poses: np.ndarray, translations: np.ndarray, fps: float
) -> None:
    if poses.shape[1:] != (model.joint_count, 3) or not len(poses):
        raise ValueError(f"poses: expected (frames, {model.joint_count}, 3) axis-angles, got {poses.shape}")
    if translations.shape != (len(poses), 3):
        raise ValueError(f"translations: expected ({len(poses)}, 3), got {translations.shape}")
    if len(shape) > model.shape_count:
        raise ValueError(f"shape: {len(shape)} coefficients for {model.shape_count} shape directions")
    for name, numbers in (("poses", poses), ("translations", translations), ("shape", shape)):
        if not np.isfinite(numbers).all():
            raise ValueError(f"{name}: holds NaN or infinite numbers")
    if not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"fps: expected a positive number, got {fps}")
