"""Left hands are mirrored right ones: the model, the pose, and the proof that both agree."""

import torch

from corporeal.model.files import open_model
from corporeal.model.mirror import mirror_pose
from corporeal.model.pose import FullPose

right, left = open_model("hand", "right"), open_model("hand", "left")
torch.manual_seed(0)
pose = FullPose(0.3 * torch.randn(1, right.joint_count, 3, dtype=torch.float64))
shape = torch.randn(1, 5, dtype=torch.float64)

of_right = right(shape, pose).vertices
of_left = left(shape, mirror_pose(pose)).vertices
difference = (of_left - of_right * torch.tensor([-1.0, 1, 1], dtype=torch.float64)).abs().max()
print(f"mirrored model of the mirrored pose against the mirrored surface: {difference:.1e} m")
