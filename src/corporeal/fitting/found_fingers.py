"""Fingers followed back in the records of a tracked sequence; what was found is kept beside them."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from corporeal.fitting.files import frame_path, read_frame
from corporeal.fitting.fingers_back import TrackedSequence, fingers_back
from corporeal.fitting.frame_fit import FrameFitter
from corporeal.fitting.gaps import SeenPose
from corporeal.model.formats.archive import write_archive
from corporeal.scans.scan import Scan

FINGERS = "fingers.npz"


def found_fingers(
    folder: Path, names: Sequence[str], fitter: FrameFitter, scan_of: Callable[[str], Scan | None],
    on_frame: Callable[[str], None] | None = None,
) -> dict[str, Float[np.ndarray, "K 3"]]:  # fmt: skip
    """The poses of the frames whose fingers ``fingers_back`` finds elsewhere, by the frames' names.

    They are read from ``fingers.npz`` where that was made from the same records, else it is written.

    Args:
        folder: of the tracked sequence.
        names: of its frames, in their order; all have a record.
        fitter: of the subject's model, as it was tracked.
        scan_of: reads the scan of a frame; None where there is none.
        on_frame: told the name of every frame that is looked at again.

    Raises:
        TrackFileError: a record is damaged.
        OSError: a record cannot be read, or the file not be written.
    """
    frames, translations, made_from = [], [], hashlib.sha256()
    for name in names:
        record = read_frame(frame_path(folder, name))
        state, frame = record.state, record.frame
        frames.append(SeenPose(state.pose, frame.signals, frame.status != "failed"))
        translations.append(state.translation)
        seen = {key: share for key, share in frame.signals.items() if key.endswith("_seen")}
        made_from.update(json.dumps([name, frame.status, record.sha256, seen], sort_keys=True).encode())
        made_from.update(state.pose.tobytes() + state.translation.tobytes())
    known = _read(folder / FINGERS, made_from.hexdigest())
    if known is None:
        tell = on_frame or (lambda name: None)
        tracked = TrackedSequence(
            frames, np.array(translations).reshape(-1, 3), lambda number: scan_of(names[number])
        )
        found = fingers_back(fitter, tracked, lambda number: tell(names[number]))
        known = {names[number]: pose for number, pose in sorted(found.items())}
        poses = np.array(list(known.values())).reshape(len(known), fitter.model.joint_count, 3)
        content = {"made_from": np.array(made_from.hexdigest()), "frames": np.array(list(known), dtype=str)}
        write_archive(folder / FINGERS, content | {"poses": poses})
    return known


def _read(path: Path, made_from: str) -> dict[str, Float[np.ndarray, "K 3"]] | None:
    """None where the file is absent, damaged, or made from other records: it is then made again."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as archive:
            if str(archive["made_from"]) != made_from:
                return None
            return dict(zip(archive["frames"].tolist(), archive["poses"], strict=True))
    except Exception:  # Damaged bytes make the zip and npy parsers raise nearly anything.
        return None
