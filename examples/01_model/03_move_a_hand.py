"""Turn a posed hand about a point of your choice: the root does not turn about the origin."""

import torch

from corporeal.geometry.rotations import matrix_from_axis_angle
from corporeal.model.files import open_model
from corporeal.model.pose import FullPose
from corporeal.model.rigid import apply_rigid

hand = open_model("hand")
pose = FullPose(torch.zeros(1, hand.joint_count, 3, dtype=torch.float64))
shape = torch.zeros(1, 1, dtype=torch.float64)
translation = torch.zeros(1, 3, dtype=torch.float64)
R = matrix_from_axis_angle(torch.tensor([[0.0, 0.0, 1.5]], dtype=torch.float64))
t = torch.tensor([[0.1, 0.2, 0.3]], dtype=torch.float64)

moved_pose, moved_translation = apply_rigid(hand, R, t, shape, pose, translation)
expected = hand(shape, pose).vertices @ R[0].T + t
got = hand(shape, moved_pose, translation=moved_translation).vertices
print(f"largest difference {(got - expected).abs().max():.1e} m")
