"""A posed model as a GLB file: skin, morph targets and an animation from the zero pose to the fitted one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from corporeal.atomic import write_bytes
from corporeal.export.gltf_morphs import MorphTargets, coefficient_targets, corrective_targets
from corporeal.export.gltf_scene import AnimatedModel, glb_bytes
from corporeal.model.surface_model import SurfaceModel


@dataclass(frozen=True)
class GlbOptions:
    """What a GLB file holds beside skin and correctives.

    Attributes:
        shape_targets: so many of the first shape directions become morph targets; the others are baked in.
        expression_targets: the same for expressions.
        keys: key frames of the animation, the zero pose and the fitted pose included.
        seconds: its length.
        colour: linear red, green, blue of the material, 0..1.
    """

    shape_targets: int = 10
    expression_targets: int = 10
    keys: int = 11
    seconds: float = 2.0
    colour: tuple[float, float, float] = (0.60, 0.38, 0.29)


def write_glb(
    path: Path | str,
    model: SurfaceModel,
    shape: Float[np.ndarray, " s"],
    pose: Float[np.ndarray, "K 3"],
    translation: Float[np.ndarray, 3],
    *,
    expression: Float[np.ndarray, " e"] | None = None,
    correctives: bool = True,
    options: GlbOptions | None = None,
) -> None:
    """Write one skinned mesh with the model's joints as nodes, which opens in the fitted shape and pose.

    The animation ``zero_to_fit`` turns every joint from the zero pose to the fitted one; its pose at time t
    is the fitted axis-angle times t / seconds. One ``weights`` channel drives the pose correctives. At every
    key the file evaluates to the model's own vertices (``gltf_check`` reads it back); between keys glTF
    interpolates weights linearly, while correctives are a smooth function of the angles.

    glTF cannot move joints by morph targets, but the joints of a model move with its shape. Joint nodes and
    inverse bind matrices are those of the fitted shape: shape targets at their default weights (the fitted
    coefficients) are exact, other weights show the other shape on the fitted one's skeleton. The same holds
    for expressions. The translation is the same at all times; the root turns about its own rest joint.

    A vertex with more than four joints gets a second set (``JOINTS_1``, ``WEIGHTS_1``), the largest weights
    first, since some viewers read only the first set. Joints of weight below 1e-6 are dropped (3 um).

    Args:
        path: the file; its folder is made if it is missing.
        model: the model; a left hand is the mirrored model.
        shape: coefficients of the first shape directions.
        pose: axis-angle of all joints, radians.
        translation: metres.
        expression: coefficients of the first expression directions, or None.
        correctives: False leaves the pose correctives out.
        options: what else the file holds.

    Raises:
        ValueError: arguments that do not fit the model or are not finite, fewer than two keys, or angles too
            large for so few keys.
    """
    options = options or GlbOptions()
    expression = np.zeros(0) if expression is None else expression
    _check_arguments(model, shape, pose, translation, expression, options)
    fractions = np.linspace(0, 1, options.keys)
    poses = fractions[:, None, None] * pose
    rest = _fitted_rest(model, shape, expression)
    targets = _blend_targets(model, shape, expression, options)
    # What the shape and expression targets do not hold is baked into the base mesh.
    base = rest - np.einsum("t,tvc->vc", targets.weights[0], targets.displacements)
    if correctives and model.has_correctives:
        targets = targets.joined(corrective_targets(model, poses))
    scene = AnimatedModel(
        model=model,
        rest=rest,
        base=base,
        targets=targets,
        poses=poses,
        translations=translation[None],
        times=fractions * options.seconds,
        opened=options.keys - 1,
    )
    write_bytes(path, glb_bytes(scene, animation="zero_to_fit", colour=options.colour))


def _check_arguments(
    model: SurfaceModel, shape: np.ndarray, pose: np.ndarray, translation: np.ndarray, expression: np.ndarray,
    options: GlbOptions,
) -> None:  # fmt: skip
    if pose.shape != (model.joint_count, 3):
        raise ValueError(f"pose: expected ({model.joint_count}, 3) axis-angles, got {pose.shape}")
    for name, numbers, limit in (
        ("shape", shape, model.shape_count),
        ("expression", expression, model.expression_count),
    ):
        if len(numbers) > limit:
            raise ValueError(f"{name}: {len(numbers)} coefficients for {limit} {name} directions")
    numbers_by_name = {"pose": pose, "shape": shape, "translation": translation, "expression": expression}
    for name, numbers in numbers_by_name.items():
        if not np.isfinite(numbers).all():
            raise ValueError(f"{name}: holds NaN or infinite numbers")
    if options.keys < 2:
        raise ValueError(f"keys: an animation needs at least 2, got {options.keys}")
    # glTF turns the short way from key to key.
    if np.linalg.norm(pose, axis=1).max() / (options.keys - 1) >= np.pi:
        raise ValueError("pose: turns by more than half a turn between two keys; use more keys")


def _fitted_rest(model: SurfaceModel, shape: np.ndarray, expression: np.ndarray) -> np.ndarray:
    """(V, 3) vertices of the fitted shape at the zero pose."""
    expressed = model.expression_directions[:, :, : len(expression)] @ expression
    return model.template + model.shape_directions[:, :, : len(shape)] @ shape + expressed


def _blend_targets(
    model: SurfaceModel, shape: np.ndarray, expression: np.ndarray, options: GlbOptions
) -> MorphTargets:
    shape_directions = model.shape_directions[:, :, : options.shape_targets]
    expression_directions = model.expression_directions[:, :, : options.expression_targets]
    targets = coefficient_targets("shape", shape_directions, shape, options.keys)
    return targets.joined(coefficient_targets("expression", expression_directions, expression, options.keys))
