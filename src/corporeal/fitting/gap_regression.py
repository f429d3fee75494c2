"""What a joint does while it is out of sight, told by what it did while it was seen: a Gaussian process.

A straight way between the poses before and after a gap knows nothing of a swing in between. But an elbow
that is missing swings as it did a step ago, with the legs, the trunk and its own upper arm; and no joint
changes at once. Both are in the covariance of one process: frames that are near in time go together, and
frames that are near in what is seen of the rest.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

# Seconds within which a joint's pose lasts, and within which a motion is repeated alike.
_LASTS, _REPEATS = 0.4, 3.0
# Radians by which the rest of two poses differs that say little of each other; features are weighed for it.
_ALIKE = 1.5
# The parts of the variance that time alone, and the rest of the pose, tell.
_BY_TIME = 0.5
# Radians: what is tracked of a joint is no better.
_NOISE = np.deg2rad(1.0)
# Seconds before and after a gap that are asked.
_ASKED = 5.0
# Seconds: by so much of its change a feature says where in a swing a frame is.
_CHANGE = 0.05


@dataclass(frozen=True, eq=False)
class SeenMotion:
    """What a regression goes by.

    Attributes:
        features: (N, f) of every frame: radians, and their change within 0.05 s.
        known: (N,) frames in which the joint is seen.
        fps: frames per second.
    """

    features: Float[np.ndarray, "N f"]
    known: Bool[np.ndarray, " N"]
    fps: float

    @classmethod
    def of_angles(
        cls, angles: Float[np.ndarray, "N a"], known: Bool[np.ndarray, " N"], fps: float
    ) -> SeenMotion:
        """That of angles (radians) and their change; two frames at least."""
        change = _CHANGE * fps * np.gradient(angles, axis=0)
        return cls(np.concatenate([angles, change], axis=1), known, fps)

    def told(self, values: Float[np.ndarray, "N d"], first: int, after: int) -> Float[np.ndarray, "g d"]:
        """The values of the frames of a gap by those of the frames about it that are known, radians.

        Args:
            values: of every frame; those that are not known do not count.
            first: frame of the gap.
            after: the first frame after it.
        """
        about = round(_ASKED * self.fps)
        near = np.arange(max(first - about, 0), min(after + about, len(values)))
        asked = near[self.known[near]]
        mean = values[asked].mean(axis=0)
        variance = max(float(values[asked].var(axis=0).sum()), _NOISE**2)
        among = self._covariance(asked, asked) + _NOISE**2 / variance * np.eye(len(asked))
        across = self._covariance(np.arange(first, after), asked)
        return mean + across @ np.linalg.solve(among, values[asked] - mean)

    def turns_told(self, turns: Float[np.ndarray, "N 3"], first: int, after: int) -> Float[np.ndarray, "g 3"]:
        """The same of a joint's axis-angles, taken from their mean turn."""
        rotations = Rotation.from_rotvec(turns)
        middle = rotations[self.known].mean()
        told = self.told((middle.inv() * rotations).as_rotvec(), first, after)
        return (middle * Rotation.from_rotvec(told)).as_rotvec()

    def _covariance(self, ones: Int[np.ndarray, " m"], others: Int[np.ndarray, " n"]) -> np.ndarray:
        """(m, n) of frames, of variance 1."""
        seconds = (ones[:, None] - others) / self.fps
        apart = np.square(self.features[ones, None] - self.features[others]).sum(axis=2)
        alike = np.exp(-apart / (2 * _ALIKE**2) - seconds**2 / (2 * _REPEATS**2))
        return _BY_TIME * np.exp(-(seconds**2) / (2 * _LASTS**2)) + (1 - _BY_TIME) * alike
