"""Gaps of a tracked sequence bridged in its records on disk, a few numbers of each in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import groupby
from pathlib import Path

from corporeal.fitting.files import frame_path, read_frame, write_frame
from corporeal.fitting.gaps import BridgedPose, SeenPose, bridged
from corporeal.model.surface_model import SurfaceModel

_BRIDGED, _LED = "_bridged", "_led"


def bridge_records(
    folder: Path,
    names: Sequence[str],
    model: SurfaceModel,
    fps: float,
    on_change: Callable[[str], None] | None = None,
) -> list[str]:
    """Bridge gaps, and lead fingers to where they are found, as ``gaps.bridged`` does.

    A record in a gap has a signal "left_hand_bridged", one whose fingers are led "left_hand_led".

    What was tracked stays in the record's ``state``, from which every call begins: repeated, after a run
    that was broken off or with more frames, it gives what one call at the end would have given.

    Args:
        folder: of the tracked sequence.
        names: of its frames, in their order; all have a record.
        model: the subject's.
        fps: frames per second.
        on_change: told the names of the frames whose records change, before they do.

    Returns:
        A sentence for every gap.

    Raises:
        TrackFileError: a record is damaged.
        OSError: a record cannot be read or written.
    """
    frames, stored = [], []
    for name in names:
        record = read_frame(frame_path(folder, name))
        frames.append(SeenPose(record.state.pose, record.frame.signals, record.frame.status != "failed"))
        stored.append(record.frame.pose)
    found = bridged(model, frames, fps)
    for name, frame, pose, bridge in zip(names, frames, stored, found, strict=True):
        signals = _signals(frame.signals, bridge)
        if signals == frame.signals and (pose == bridge.pose).all():
            continue
        if on_change is not None:
            on_change(name)
        path = frame_path(folder, name)
        record = read_frame(path)
        write_frame(path, replace(record, frame=replace(record.frame, pose=bridge.pose, signals=signals)))
    return _sentences(names, found)


def _signals(before: Mapping[str, float], bridge: BridgedPose) -> dict[str, float]:
    signals = {key: share for key, share in before.items() if not key.endswith((_BRIDGED, _LED))}
    signals |= {f"{hand}{_BRIDGED}": 1.0 for hand in bridge.hands}
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
