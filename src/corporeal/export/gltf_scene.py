"""What every GLB file of a model holds: material, skinned mesh, joint nodes, skin, animation, container."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pygltflib
from jaxtyping import Float

import corporeal
from corporeal.export.gltf_buffers import BufferBuilder
from corporeal.export.gltf_morphs import MorphTargets
from corporeal.geometry.normals import vertex_normals
from corporeal.geometry.rotations_numeric import quaternion_from_axis_angle
from corporeal.model.surface_model import SurfaceModel

# A vertex loses the influence of joints below this weight; the others are scaled to sum to one again. With 16
# joints a vertex moves by less than 16e-6 of the hand's length: 3 um.
_NEGLIGIBLE_WEIGHT = 1e-6


@dataclass(frozen=True, eq=False)
class AnimatedModel:
    """A model, and how it moves.

    Attributes:
        model: whose joints become nodes.
        rest: (V, 3) its vertices at the zero pose in the shape that is shown; joints are regressed from them.
        base: (V, 3) the vertices of the mesh: ``rest`` without what the targets hold.
        targets: the morph targets.
        poses: (n, K, 3) axis-angle of all joints at every key.
        translations: (n, 3) metres at every key, or (1, 3): the same at all times.
        times: (n,) of the keys, seconds.
        opened: the key that is shown before the animation plays.
    """

    model: SurfaceModel
    rest: Float[np.ndarray, "V 3"]
    base: Float[np.ndarray, "V 3"]
    targets: MorphTargets
    poses: Float[np.ndarray, "n K 3"]
    translations: Float[np.ndarray, "m 3"]
    times: Float[np.ndarray, " n"]
    opened: int


def glb_bytes(
    scene: AnimatedModel, *, animation: str, colour: tuple[float, float, float],
    most_joints: int | None = None, extras: Mapping[str, Any] | None = None,
) -> bytes:  # fmt: skip
    """The whole file.

    Args:
        scene: what it shows.
        animation: name of the animation.
        colour: linear red, green, blue of the material, 0..1.
        most_joints: that move one vertex, the largest weights first; None keeps all.
        extras: of the asset.
    """
    builder = BufferBuilder()
    gltf = pygltflib.GLTF2(
        asset=pygltflib.Asset(
            version="2.0", generator=f"corporeal {corporeal.__version__}", extras=dict(extras or {})
        ),
        scene=0,
        scenes=[pygltflib.Scene(name="scene", nodes=[0, 1])],
        materials=[_material(colour)],
        meshes=[_mesh(builder, scene, most_joints)],
        nodes=[
            pygltflib.Node(name=_unused_name(scene.model), mesh=0, skin=0),
            *_joint_nodes(scene),
        ],
        skins=[_skin(builder, scene)],
        animations=[_animation(builder, scene, animation)],
    )
    content = builder.content()
    gltf.bufferViews, gltf.accessors = builder.views, builder.accessors
    gltf.buffers = [pygltflib.Buffer(byteLength=len(content))]
    gltf.set_binary_blob(content)
    return b"".join(gltf.save_to_bytes())


def few_joints(weights: Float[np.ndarray, "V K"], most: int | None) -> Float[np.ndarray, "V K"]:
    """Skinning weights with at most so many joints per vertex, the largest ones; rows sum to one."""
    kept = np.where(weights < _NEGLIGIBLE_WEIGHT, 0, weights)
    if most is not None and most < weights.shape[1]:
        order = np.argsort(-kept, axis=1, kind="stable")
        np.put_along_axis(kept, order[:, most:], 0.0, axis=1)
    return kept / kept.sum(axis=1, keepdims=True)


def _material(colour: tuple[float, float, float]) -> pygltflib.Material:
    surface = pygltflib.PbrMetallicRoughness(
        baseColorFactor=[*colour, 1.0], metallicFactor=0.0, roughnessFactor=0.7
    )
    # Double-sided: the wrist of a hand is open, and one looks in.
    return pygltflib.Material(name="skin", pbrMetallicRoughness=surface, doubleSided=True)


def _mesh(builder: BufferBuilder, scene: AnimatedModel, most_joints: int | None) -> pygltflib.Mesh:
    vertex_data, model = pygltflib.ARRAY_BUFFER, scene.model
    attributes = pygltflib.Attributes(
        POSITION=builder.add(scene.base.astype(np.float32), target=vertex_data, bounds=True),
        NORMAL=builder.add(_normals(scene.rest, model.faces).astype(np.float32), target=vertex_data),
    )
    for number, (joints, weights) in enumerate(_influences(few_joints(model.skinning_weights, most_joints))):
        setattr(attributes, f"JOINTS_{number}", builder.add(joints, target=vertex_data))
        setattr(attributes, f"WEIGHTS_{number}", builder.add(weights, target=vertex_data))
    index_type = np.uint16 if model.vertex_count < np.iinfo(np.uint16).max else np.uint32
    indices = builder.add(model.faces.astype(index_type).ravel(), target=pygltflib.ELEMENT_ARRAY_BUFFER)
    primitive = pygltflib.Primitive(attributes=attributes, indices=indices, material=0)
    primitive.targets = [
        {"POSITION": builder.add_displacements(target.astype(np.float32))}
        for target in scene.targets.displacements
    ]
    return pygltflib.Mesh(
        name=model.name,
        primitives=[primitive],
        weights=scene.targets.weights[scene.opened].tolist(),
        extras={"targetNames": list(scene.targets.names)},
    )


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    normals = vertex_normals(vertices, faces)
    # A vertex without faces has the normal zero, which glTF does not allow.
    normals[np.linalg.norm(normals, axis=1) < 0.5] = (0, 1, 0)
    return normals


def _influences(weights: Float[np.ndarray, "V K"]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Sets of four joints and four weights per vertex, largest weights first."""
    sets = -(-int((weights > 0).sum(axis=1).max()) // 4)
    order = np.argsort(-weights, axis=1, kind="stable")[:, : 4 * sets]
    order = np.pad(order, ((0, 0), (0, 4 * sets - order.shape[1])))
    values = np.take_along_axis(weights, order, axis=1).astype(np.float32)
    values[:, weights.shape[1] :] = 0
    joint_type = np.uint8 if weights.shape[1] <= np.iinfo(np.uint8).max + 1 else np.uint16
    joints = np.where(values > 0, order, 0).astype(joint_type)
    return [(joints[:, first : first + 4], values[:, first : first + 4]) for first in range(0, 4 * sets, 4)]


def _root_places(scene: AnimatedModel) -> Float[np.ndarray, "m 3"]:
    """Where the root's node stands: its rest joint moved by the translation."""
    return np.asarray(scene.model.joint_regressor @ scene.rest)[0] + scene.translations


def _joint_nodes(scene: AnimatedModel) -> list[pygltflib.Node]:
    """One node per joint, in order, after the node of the mesh."""
    model = scene.model
    joints = np.asarray(model.joint_regressor @ scene.rest)
    offsets = joints - np.where(model.parents[:, None] < 0, 0, joints[model.parents])
    places = _root_places(scene)
    offsets[0] = places[0 if len(places) == 1 else scene.opened]
    rotations = _rotations(scene.poses[scene.opened])
    return [
        pygltflib.Node(
            name=model.joint_names[joint],
            translation=offsets[joint].tolist(),
            rotation=rotations[joint].tolist(),
            children=[1 + int(child) for child in np.flatnonzero(model.parents == joint)],
        )
        for joint in range(model.joint_count)
    ]


def _skin(builder: BufferBuilder, scene: AnimatedModel) -> pygltflib.Skin:
    model = scene.model
    inverse_bind = np.tile(np.eye(4, dtype=np.float32), (model.joint_count, 1, 1))
    inverse_bind[:, :3, 3] = -(model.joint_regressor @ scene.rest)
    joints = list(range(1, 1 + model.joint_count))
    return pygltflib.Skin(
        name="skeleton", inverseBindMatrices=builder.add(inverse_bind), skeleton=1, joints=joints
    )


def _animation(builder: BufferBuilder, scene: AnimatedModel, name: str) -> pygltflib.Animation:
    animation = pygltflib.Animation(name=name)
    key_times = builder.add(scene.times.astype(np.float32), bounds=True)

    def animate(node: int, path: str, values: np.ndarray) -> None:
        output = builder.add(values.astype(np.float32))
        animation.samplers.append(pygltflib.AnimationSampler(input=key_times, output=output))
        target = pygltflib.AnimationChannelTarget(node=node, path=path)
        animation.channels.append(
            pygltflib.AnimationChannel(sampler=len(animation.samplers) - 1, target=target)
        )

    for joint in range(scene.poses.shape[1]):
        animate(1 + joint, "rotation", _rotations(scene.poses[:, joint]))
    if len(scene.translations) > 1:
        animate(1, "translation", _root_places(scene))
    if scene.targets.names:
        animate(0, "weights", scene.targets.weights.ravel())
    return animation


def _rotations(axis_angle: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """Quaternions in glTF's order (x, y, z, w)."""
    return quaternion_from_axis_angle(axis_angle)[:, [1, 2, 3, 0]]


def _unused_name(model: SurfaceModel) -> str:
    """A name for the mesh's node that no joint has: viewers address nodes by name."""
    name = f"{model.name}_mesh"
    while name in model.joint_names:
        name += "_"
    return name
