"""A posed model as a GLB file: skin, morph targets and an animation from the zero pose to the fitted one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pygltflib
from jaxtyping import Float

import corporeal
from corporeal.atomic import write_bytes
from corporeal.export.gltf_buffers import BufferBuilder
from corporeal.export.gltf_morphs import MorphTargets, coefficient_targets, corrective_targets
from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.rotations_numeric import quaternion_from_axis_angle
from corporeal.model.surface_model import SurfaceModel

# A vertex loses the influence of joints below this weight; the others are scaled to sum to one again. With 16
# joints a vertex moves by less than 16e-6 of the hand's length: 3 um.
_NEGLIGIBLE_WEIGHT = 1e-6


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
    builder = BufferBuilder()
    gltf = pygltflib.GLTF2(
        asset=pygltflib.Asset(version="2.0", generator=f"corporeal {corporeal.__version__}"),
        scene=0,
        scenes=[pygltflib.Scene(name="scene", nodes=[0, 1])],
        materials=[_material(options.colour)],
        meshes=[_mesh(builder, model, base, _normals(rest, model.faces), targets)],
        nodes=[
            pygltflib.Node(name=_unused_name(model), mesh=0, skin=0),
            *_joint_nodes(model, rest, pose, translation),
        ],
        skins=[_skin(builder, model, rest)],
        animations=[_animation(builder, poses, targets, fractions * options.seconds)],
    )
    content = builder.content()
    gltf.bufferViews, gltf.accessors = builder.views, builder.accessors
    gltf.buffers = [pygltflib.Buffer(byteLength=len(content))]
    gltf.set_binary_blob(content)
    write_bytes(path, b"".join(gltf.save_to_bytes()))


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


def _material(colour: tuple[float, float, float]) -> pygltflib.Material:
    surface = pygltflib.PbrMetallicRoughness(
        baseColorFactor=[*colour, 1.0], metallicFactor=0.0, roughnessFactor=0.7
    )
    # Double-sided: the wrist of a hand is open, and one looks in.
    return pygltflib.Material(name="skin", pbrMetallicRoughness=surface, doubleSided=True)


def _mesh(
    builder: BufferBuilder, model: SurfaceModel, base: np.ndarray, normals: np.ndarray, targets: MorphTargets
) -> pygltflib.Mesh:
    vertex_data = pygltflib.ARRAY_BUFFER
    attributes = pygltflib.Attributes(
        POSITION=builder.add(base.astype(np.float32), target=vertex_data, bounds=True),
        NORMAL=builder.add(normals.astype(np.float32), target=vertex_data),
    )
    for number, (joints, weights) in enumerate(_influences(model.skinning_weights)):
        setattr(attributes, f"JOINTS_{number}", builder.add(joints, target=vertex_data))
        setattr(attributes, f"WEIGHTS_{number}", builder.add(weights, target=vertex_data))
    index_type = np.uint16 if model.vertex_count < np.iinfo(np.uint16).max else np.uint32
    indices = builder.add(model.faces.astype(index_type).ravel(), target=pygltflib.ELEMENT_ARRAY_BUFFER)
    primitive = pygltflib.Primitive(attributes=attributes, indices=indices, material=0)
    primitive.targets = [
        {"POSITION": builder.add(target.astype(np.float32), target=vertex_data, bounds=True)}
        for target in targets.displacements
    ]
    return pygltflib.Mesh(
        name=model.name,
        primitives=[primitive],
        weights=targets.weights[-1].tolist(),
        extras={"targetNames": list(targets.names)},
    )


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    normals = vertex_normals(vertices, faces)
    # A vertex without faces has the normal zero, which glTF does not allow.
    normals[np.linalg.norm(normals, axis=1) < 0.5] = (0, 1, 0)
    return normals


def _influences(weights: Float[np.ndarray, "V K"]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sets of four joints and four weights per vertex, largest weights first."""
    kept = np.where(weights < _NEGLIGIBLE_WEIGHT, 0, weights)
    kept = kept / kept.sum(axis=1, keepdims=True)
    sets = -(-int((kept > 0).sum(axis=1).max()) // 4)
    order = np.argsort(-kept, axis=1, kind="stable")[:, : 4 * sets]
    order = np.pad(order, ((0, 0), (0, 4 * sets - order.shape[1])))
    values = np.take_along_axis(kept, order, axis=1).astype(np.float32)
    values[:, weights.shape[1] :] = 0
    joint_type = np.uint8 if weights.shape[1] <= np.iinfo(np.uint8).max + 1 else np.uint16
    joints = np.where(values > 0, order, 0).astype(joint_type)
    return [(joints[:, first : first + 4], values[:, first : first + 4]) for first in range(0, 4 * sets, 4)]


def _joint_nodes(
    model: SurfaceModel, rest: np.ndarray, pose: np.ndarray, translation: np.ndarray
) -> list[pygltflib.Node]:
    """One node per joint, in order, after the node of the mesh."""
    joints = model.joint_regressor @ rest
    offsets = joints - np.where(model.parents[:, None] < 0, 0, joints[model.parents])
    offsets[0] += translation
    rotations = quaternion_from_axis_angle(pose)[:, [1, 2, 3, 0]]
    return [
        pygltflib.Node(
            name=model.joint_names[joint],
            translation=offsets[joint].tolist(),
            rotation=rotations[joint].tolist(),
            children=[1 + int(child) for child in np.flatnonzero(model.parents == joint)],
        )
        for joint in range(model.joint_count)
    ]


def _skin(builder: BufferBuilder, model: SurfaceModel, rest: np.ndarray) -> pygltflib.Skin:
    inverse_bind = np.tile(np.eye(4, dtype=np.float32), (model.joint_count, 1, 1))
    inverse_bind[:, :3, 3] = -(model.joint_regressor @ rest)
    joints = list(range(1, 1 + model.joint_count))
    return pygltflib.Skin(
        name="skeleton", inverseBindMatrices=builder.add(inverse_bind), skeleton=1, joints=joints
    )


def _animation(
    builder: BufferBuilder, poses: Float[np.ndarray, "n K 3"], targets: MorphTargets, times: np.ndarray
) -> pygltflib.Animation:
    animation = pygltflib.Animation(name="zero_to_fit")
    key_times = builder.add(times.astype(np.float32), bounds=True)

    def animate(node: int, path: str, values: np.ndarray) -> None:
        output = builder.add(values.astype(np.float32))
        animation.samplers.append(pygltflib.AnimationSampler(input=key_times, output=output))
        target = pygltflib.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(
            pygltflib.AnimationChannel(sampler=len(animation.samplers) - 1, target=target)
        )

    for joint in range(poses.shape[1]):
        animate(1 + joint, "rotation", quaternion_from_axis_angle(poses[:, joint])[:, [1, 2, 3, 0]])
    if targets.names:
        animate(0, "weights", targets.weights.ravel())
    return animation


def _unused_name(model: SurfaceModel) -> str:
    """A name for the mesh's node that no joint has: viewers address nodes by name."""
    name = f"{model.name}_mesh"
    while name in model.joint_names:
        name += "_"
    return name
