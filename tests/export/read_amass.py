"""Reads a motion file and knows nothing but the key layout of AMASS: python read_amass.py FILE.npz"""

import json
import sys

import numpy as np

with np.load(sys.argv[1], allow_pickle=False) as file:
    motion = {key: file[key] for key in file.files}
kind = str(motion["surface_model_type"]) if "surface_model_type" in motion else "smplh"
rate = float(motion["mocap_frame_rate" if kind == "smplx" else "mocap_framerate"])
poses, trans, betas = motion["poses"], motion["trans"], motion["betas"]
sizes = {"smplh": (3, 63, 90), "smplx": (3, 63, 3, 6, 90)}[kind]
parts = np.split(poses, np.cumsum(sizes)[:-1], axis=1)
assert poses.shape == (len(trans), sum(sizes)) and trans.shape[1] == 3 and betas.ndim == 1
if kind == "smplx":
    for key, part in zip(
        ("root_orient", "pose_body", "pose_jaw", "pose_eye", "pose_hand"), parts, strict=True
    ):
        assert np.array_equal(motion[key], part), key
walked = float(np.linalg.norm(np.diff(trans, axis=0), axis=1).sum())
fists = np.linalg.norm(parts[-1].reshape(len(poses), 2, 15, 3), axis=3).mean(axis=(1, 2)).tolist()
print(json.dumps({"gender": str(motion["gender"]), "type": kind, "seconds": len(poses) / rate,
                  "walked_m": walked, "finger_radians": fists}))  # fmt: skip
