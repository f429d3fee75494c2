"""Track a sequence from Python: what ``corporeal track`` does with folders of scans, frame by frame.

The sequence is made here, so that it runs anywhere: a hand of one shape that closes, one frame missing. A
body is tracked by the same lines, with ``open_model("body")`` and a registration of its first frame as start.
"""

from pathlib import Path

import numpy as np

from corporeal.export.amass import Motion, write_amass
from corporeal.export.animation import write_animation
from corporeal.fitting.learn_template import learn_subject_template
from corporeal.fitting.options import TrackingOptions
from corporeal.fitting.track import Tracker
from corporeal.geometry.normals import vertex_normals
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.scans.scan import Scan, Unit
from corporeal.terms.model_fields import ModelParameters

FRAMES, FPS, MISSING = 8, 60.0, 4
hand = open_model("hand")
rng = np.random.default_rng(0)
fingers = next(block for block in hand.pose_blocks if len(block.components))
shape = np.array([1.0, -0.5, 0.5])


def true_pose(frame: int) -> np.ndarray:
    pose = np.zeros((hand.joint_count, 3))
    pose[list(fingers.joints)] = (fingers.mean + 0.1 * frame * fingers.components[0]).reshape(-1, 3)
    return pose


def true_vertices(frame: int) -> np.ndarray:
    return evaluate(hand, shape, true_pose(frame), np.array([0.003 * frame, 0, 0])).vertices


def scan(frame: int) -> Scan | None:
    if frame == MISSING:
        return None
    points = true_vertices(frame)
    points = points + 2e-4 * rng.standard_normal(points.shape)
    normals = vertex_normals(points, hand.faces)
    return Scan(f"{frame:04d}", points, hand.faces, normals, None, Unit("m", 1.0))


scans = [scan(frame) for frame in range(FRAMES)]
named = [(f"{frame:04d}", one) for frame, one in enumerate(scans)]

# Stage one: the subject's own template, from a rough start in the first frame.
start = ModelParameters(np.full(3, 0.002), true_pose(0), np.zeros(3))
options = TrackingOptions(template_frames=3, samples=4000, body_points=2000)
template = learn_subject_template(named, hand, start, options)
truth = hand.template + hand.shape_directions[:, :, :3] @ shape
off = 1e3 * np.linalg.norm(template.model.template - truth, axis=1).mean()
print(f"template from frames {', '.join(template.used)}: {off:.2f} mm from the truth")

# Stage two: every frame from the last; the tracker's state is all that a resumed run needs.
tracker = Tracker(template, options)
frames = [tracker.step(one, name, reason="the file is missing") for name, one in named]
for number, frame in enumerate(frames):
    vertices = evaluate(template.model, np.zeros(0), frame.pose, frame.translation).vertices
    error = 1e3 * np.linalg.norm(vertices - true_vertices(number), axis=1).mean()
    print(f"{frame.name}: {frame.status} {frame.reason}; {error:.2f} mm from the truth")

folder = Path("demo-out")
poses, places = np.array([f.pose for f in frames]), np.array([f.translation for f in frames])
write_amass(folder / "track.npz", Motion(poses, places, template.shape, FPS))
summary = write_animation(folder / "track.glb", template.model, np.zeros(0), poses, places, FPS)
print(f"wrote {folder / 'track.npz'} and {folder / 'track.glb'}, {summary.keys} keys")
