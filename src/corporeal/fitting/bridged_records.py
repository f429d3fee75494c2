"""Gaps of a tracked sequence bridged in its records on disk, a few numbers of each in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
from jaxtyping import Float

from corporeal.fitting.files import frame_path, read_frame, write_frame
from corporeal.fitting.gaps import BridgedPose, SeenPose, bridged
from corporeal.fitting.pose_terms import is_hand
from corporeal.model.surface_model import SurfaceModel

_BRIDGED, _LED, _FOUND = "_bridged", "_led", "_found"


def bridge_records(
    folder: Path,
    names: Sequence[str],
    model: SurfaceModel,
    fps: float,
    found: Mapping[str, Float[np.ndarray, "K 3"]],
    on_change: Callable[[str], None] | None = None,
) -> list[str]:
    """Take found fingers in, bridge gaps, and lead fingers to where they are, as ``gaps.bridged`` does.

    A record in a gap has a signal "left_hand_bridged", one whose fingers are led "left_hand_led", one whose
    fingers were followed back "left_hand_found".

    What was tracked stays in the record's ``state``, from which every call begins: repeated, after a run
    that was broken off or with more frames, it gives what one call at the end would have given.

    Args:
        folder: of the tracked sequence.
        names: of its frames, in their order; all have a record.
        model: the subject's.
        fps: frames per second.
        found: poses, by the names of the frames, that take the place of what was tracked.
        on_change: told the names of the frames whose records change, before they do.

    Returns:
        A sentence for every gap, and for all frames of each hand that were mended by found fingers.

    Raises:
        TrackFileError: a record is damaged.
        OSError: a record cannot be read or written.
    """
    frames, stored, elsewhere = [], [], []
    hands = {block.name: list(block.joints) for block in model.pose_blocks if is_hand(block)}
    for name in names:
        record = read_frame(frame_path(folder, name))
        tracked = record.state.pose
        pose = found.get(name, tracked)
        frames.append(SeenPose(pose, record.frame.signals, record.frame.status != "failed"))
        stored.append(record.frame.pose)
        elsewhere.append([hand for hand, joints in hands.items() if (pose[joints] != tracked[joints]).any()])
    poses = bridged(model, frames, fps)
    for name, frame, before, bridge, others in zip(names, frames, stored, poses, elsewhere, strict=True):
        signals = _signals(frame.signals, bridge, others)
        if signals == frame.signals and (before == bridge.pose).all():
            continue
        if on_change is not None:
            on_change(name)
        path = frame_path(folder, name)
        record = read_frame(path)
        write_frame(path, replace(record, frame=replace(record.frame, pose=bridge.pose, signals=signals)))
    return _sentences(names, poses) + [
        f"fingers of the {hand.replace('_', ' ')} in {count} frames are those that were found later"
        for hand in hands
        if (count := sum(hand in others for others in elsewhere))
    ]


def _signals(before: Mapping[str, float], bridge: BridgedPose, found: Sequence[str]) -> dict[str, float]:
    signals = {key: share for key, share in before.items() if not key.endswith((_BRIDGED, _LED, _FOUND))}
    signals |= {f"{hand}{_BRIDGED}": 1.0 for hand in bridge.hands}
    signals |= {f"{hand}{_FOUND}": 1.0 for hand in found}
    return signals | {f"{hand}{_LED}": 1.0 for hand in bridge.led}


def _sentences(names: Sequence[str], found: Sequence[BridgedPose]) -> list[str]:
    said = []
    for hand in sorted({hand for pose in found for hand in pose.hands}):
        for within, group in groupby(zip(names, found, strict=True), key=lambda pair: hand in pair[1].hands):
            if within:
                between = [name for name, _ in group]
                said.append(
                    f"{hand.replace('_', ' ')} out of sight from {between[0]} to {between[-1]}: "
                    "its pose there is laid between those before and after"
                )
    return said
