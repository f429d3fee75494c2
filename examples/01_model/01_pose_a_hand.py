"""Pose the open hand, in a batch, and differentiate through it."""

import torch

from corporeal.model.files import open_model
from corporeal.model.pose import CoefficientPose, FullPose

hand = open_model("hand")
print(f"{hand.name}: {hand.vertex_count} vertices, {hand.joint_count} joints, {hand.shape_count} shapes")

# Three hands: the mean pose moved along the first two principal components, with different shapes.
coefficients = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
pose = CoefficientPose(root=torch.zeros(3, 3), coefficients={"hand": coefficients})
shape = torch.tensor([[0.0], [1.0], [-1.0]], requires_grad=True)
posed = hand(shape, pose)
print("vertices", tuple(posed.vertices.shape), "joints", tuple(posed.joints.shape))

# A full pose is another type: its rotations are absolute, nothing is added to them.
flat = hand(None, FullPose(torch.zeros(1, hand.joint_count, 3)))
length = flat.vertices[0, :, 0].max() - flat.vertices[0, :, 0].min()
print(f"flat hand: {100 * length:.1f} cm from stump to finger tip")

posed.vertices.square().sum().backward()
print("gradient with respect to shape", shape.grad.flatten().tolist())
