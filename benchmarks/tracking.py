"""Tracked sequences against the truth of the simulator: vertices, hands, jumps, recovery, time.

    python benchmarks/tracking.py SEQUENCES TRACKED [--every N] [--json FILE]

SEQUENCES is what ``corporeal simulate SEQUENCES --body`` wrote, TRACKED what ``corporeal track`` did with it.
Per sequence and over all frames:

body      distance of the ``placed`` vertices of a frame's surface (the posed template with its free vertices)
          from their true places, mean, mm; frames that failed are left out, and counted as failed
there     the same without the hands and forearms that are missing
hands     the same of the vertices that the scanner saw on hands that are not missing (nor their forearm)
whole     the same of all placed vertices of those hands, seen or not
gone      the same of all placed vertices of missing hands: how far a guess is off
s2m       scan to the frame's surface, mean, mm
posed     as body, of the posed template, without free vertices
model     scan to the posed template, mean, mm
turn      the largest turn of a finger joint to the next frame, degrees: the angle of R_before^T R_now; not
          where the recorded motion itself jumps, a joint by more than 12 cm within a frame
back      frames until a hand that was missing is well again, the longest: the first frame after its return in
          which the distance of its placed vertices is at most 1.5 times its mean (over frames in which it
          is visible, but not within ten after a return), or 1.5 times that in the last frame before the
          loss if it was farther off then, counts as 0, 1, ...; "never" where the sequence ends, or the next
          loss begins, before
s/frame   mean time of a frame, reading included; the template's is not in it

Distances are taken in every N-th frame; turns in all; recovery in all that follow a return.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from corporeal.fitting.files import TEMPLATE, FrameRecord, read_frame, read_story
from corporeal.geometry.rotations_numeric import matrix_from_axis_angle
from corporeal.model.files import load_model
from corporeal.model.jacobian import evaluate
from corporeal.model.surface_model import SurfaceModel

HANDS = ("left_hand", "right_hand")
WELL_AGAIN = 1.5
AFTER = 10
# Metres within a frame of 1/60 s: recordings have flaws in which a limb is elsewhere at once.
JUMP = 0.12
COLUMNS = ("body", "there", "hands", "whole", "gone", "s2m", "posed", "model")


@dataclass(eq=False)
class Score:
    """What was measured of one sequence; lists hold a number per frame, or per frame and hand."""

    distances: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in COLUMNS})
    turn: float = 0.0
    turned: str = ""
    back: list[int | None] = field(default_factory=list)
    statuses: Counter[str] = field(default_factory=Counter)
    seconds: list[float] = field(default_factory=list)
    template_seconds: float | None = None

    def add(self, other: Score) -> None:
        """Take another sequence in."""
        for name in COLUMNS:
            self.distances[name] += other.distances[name]
        if other.turn > self.turn:
            self.turn, self.turned = other.turn, other.turned
        self.back += other.back
        self.statuses += other.statuses
        self.seconds += other.seconds

    def row(self) -> dict:
        """Means and extremes, of JSON's types."""
        means = {
            name: float(np.mean(numbers)) if numbers else None for name, numbers in self.distances.items()
        }
        known = [frames for frames in self.back if frames is not None]
        return {
            **{f"{name}_mm": mean for name, mean in means.items()},
            "turn_degrees": self.turn,
            "turn_at": self.turned,
            "returns": len(self.back),
            "frames_to_recover": max(known, default=None),
            "never_recovered": len(self.back) - len(known),
            "statuses": {name: self.statuses[name] for name in ("ok", "doubtful", "failed")},
            "seconds_per_frame": float(np.mean(self.seconds)) if self.seconds else None,
            "template_seconds": self.template_seconds,
        }


class Truth:
    """The simulator's truth of one sequence, a frame at a time."""

    def __init__(self, folder: Path, model: SurfaceModel) -> None:
        self._folder = folder / "truth"
        self._model = model
        blocks = {block.name: list(block.joints) for block in model.pose_blocks}
        self.hands = {hand: model.skinning_weights[:, blocks[hand]].sum(axis=1) > 0.5 for hand in HANDS}
        self.fingers = [joint for hand in HANDS for joint in blocks[hand]]
        self._parts = {
            f"{hand[:-5]}_forearm": self.hands[hand] | self._carried_by(f"{hand[:-5]}_elbow")
            for hand in HANDS
        } | self.hands

    def missing(self, name: str) -> set[str]:
        """Hands that were taken away, with their forearm or alone."""
        gone = self._gone(name)
        return {hand for hand in HANDS if hand in gone or hand.replace("hand", "forearm") in gone}

    def lost(self, name: str) -> np.ndarray:
        """(V,) vertices on parts that were taken away."""
        nothing = np.zeros(self._model.vertex_count, bool)
        return np.logical_or.reduce([nothing, *(self._parts[part] for part in self._gone(name))])

    def _gone(self, name: str) -> set[str]:
        with np.load(self._folder / f"{name}.npz", allow_pickle=False) as truth:
            return {str(part) for part in truth["missing"]}

    def _carried_by(self, joint: str) -> np.ndarray:
        return self._model.skinning_weights[:, self._model.joint_names.index(joint)] > 0.5

    def joints(self, name: str) -> np.ndarray:
        """(K, 3) true places, metres."""
        with np.load(self._folder / f"{name}.npz", allow_pickle=False) as truth:
            return truth["joints"]

    def distances(
        self, record: FrameRecord, *, free: bool = True
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(V,) mm from every vertex to its true place; which have one; which the scanner saw."""
        frame = record.frame
        found = evaluate(self._model, np.zeros(0), frame.pose, frame.translation).vertices
        if free and frame.offsets is not None:
            found = found + frame.offsets
        with np.load(self._folder / f"{frame.name}.npz", allow_pickle=False) as truth:
            return 1e3 * np.linalg.norm(found - truth["template"], axis=1), truth["placed"], truth["seen"]

    def hand(self, record: FrameRecord, hand: str) -> float:
        """Mean over a hand's placed vertices, mm."""
        mm, placed, _ = self.distances(record)
        return float(mm[placed & self.hands[hand]].mean())


def scored(sequence: Path, tracked: Path, every: int) -> Score:
    """Compare one tracked sequence with its truth."""
    truth = Truth(sequence, load_model(tracked / TEMPLATE))
    records = [read_frame(path) for path in sorted((tracked / "frames").glob("*.npz"))]
    missing = [truth.missing(record.frame.name) for record in records]
    score = Score(statuses=Counter(record.frame.status for record in records))
    story = read_story(tracked) or {}
    score.template_seconds = sum(story.get("seconds", {}).values()) or None
    visible = _add_distances(score, truth, records, missing, every)
    _add_turns(score, truth, records)
    for hand in HANDS:
        usual = np.mean(visible[hand]) if visible[hand] else np.nan
        score.back += [
            frames_to_recover(truth, records, missing, hand, returned, usual)
            for returned in returns(missing, hand)
        ]
    return score


def _add_distances(
    score: Score, truth: Truth, records: list[FrameRecord], missing: list[set[str]], every: int
) -> dict[str, list[float]]:
    """Fill the distances in; gives each hand's, in frames where it is visible and well after a return."""
    visible: dict[str, list[float]] = {hand: [] for hand in HANDS}
    recent = {
        hand: {frame for first in returns(missing, hand) for frame in range(first, first + AFTER)}
        for hand in HANDS
    }
    for number, record in enumerate(records):
        frame = record.frame
        score.seconds.append(frame.seconds["total"])
        if frame.s2m_mm is not None and frame.status != "failed":
            score.distances["s2m"].append(frame.s2m_mm["mean"])
            score.distances["model"].append(frame.signals["model_s2m_mm"])
        if number % every or frame.status == "failed":
            continue
        mm, placed, seen = truth.distances(record)
        score.distances["body"].append(float(mm[placed].mean()))
        score.distances["posed"].append(float(truth.distances(record, free=False)[0][placed].mean()))
        score.distances["there"].append(float(mm[placed & ~truth.lost(frame.name)].mean()))
        for hand, mask in truth.hands.items():
            whole = float(mm[mask & placed].mean())
            score.distances["gone" if hand in missing[number] else "whole"].append(whole)
            if hand in missing[number]:
                continue
            if (mask & placed & seen).any():
                score.distances["hands"].append(float(mm[mask & placed & seen].mean()))
            if number not in recent[hand]:
                visible[hand].append(whole)
    return visible


def _add_turns(score: Score, truth: Truth, records: list[FrameRecord]) -> None:
    for before, now in pairwise(records):
        if not before.state.fitted:
            continue  # it stands as the registration left it: nothing has been tracked yet
        moved = np.linalg.norm(truth.joints(now.frame.name) - truth.joints(before.frame.name), axis=1)
        if moved.max() > JUMP:
            continue
        turns = turns_degrees(before.frame.pose[truth.fingers], now.frame.pose[truth.fingers])
        if turns.max() > score.turn:
            score.turn = float(turns.max())
            score.turned = f"joint {truth.fingers[int(turns.argmax())]}, frame {now.frame.name}"


def turns_degrees(before: np.ndarray, now: np.ndarray) -> np.ndarray:
    """(n,) angles of the rotations that lead from (n, 3) axis-angles to others."""
    relative = matrix_from_axis_angle(before).transpose(0, 2, 1) @ matrix_from_axis_angle(now)
    skew = relative - relative.transpose(0, 2, 1)
    sine = 0.5 * np.linalg.norm(skew[:, [2, 0, 1], [1, 2, 0]], axis=1)
    # Not the arc cosine alone: near zero it cannot tell 0 from 1e-6 degrees.
    return np.rad2deg(np.arctan2(sine, 0.5 * (np.einsum("nii->n", relative) - 1)))


def returns(missing: list[set[str]], hand: str) -> list[int]:
    """Frames in which a hand is there again."""
    return [
        number
        for number in range(1, len(missing))
        if hand in missing[number - 1] and hand not in missing[number]
    ]


def frames_to_recover(
    truth: Truth, records: list[FrameRecord], missing: list[set[str]], hand: str, returned: int, usual: float
) -> int | None:
    """Frames after a return until the hand is well again; None where the end or the next loss comes first."""
    before = next((k for k in range(returned - 1, -1, -1) if hand not in missing[k]), None)
    if before is not None:
        usual = np.fmax(usual, truth.hand(records[before], hand))
    for number in range(returned, len(records)):
        if hand in missing[number]:
            return None
        if (
            records[number].frame.status != "failed"
            and truth.hand(records[number], hand) <= WELL_AGAIN * usual
        ):
            return number - returned
    return None


def line(name: str, row: dict) -> str:
    """One row of the table."""
    numbers = [row[f"{column}_mm"] for column in COLUMNS]
    words = [f"{number:6.2f}" if number is not None else "     -" for number in numbers]
    longest = "-" if row["frames_to_recover"] is None else str(row["frames_to_recover"])
    never = f" ({row['never_recovered']} never)" if row["never_recovered"] else ""
    statuses = "/".join(str(count) for count in row["statuses"].values())
    per_frame = "-" if row["seconds_per_frame"] is None else f"{row['seconds_per_frame']:.2f}"
    back = f"{longest} of {row['returns']}{never}"
    return f"{name:16} {' '.join(words)} {row['turn_degrees']:6.1f} {back:>14} {statuses:>12} {per_frame:>8}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sequences", type=Path)
    parser.add_argument("tracked", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    folders = sorted(path.parent for path in asked.tracked.glob(f"*/{TEMPLATE}"))
    if not folders:
        parser.error(f"{asked.tracked}: holds no tracked sequence")
    heads = " ".join(f"{column:>6}" for column in COLUMNS)
    print(f"{'':16} {heads} {'turn':>6} {'back':>14} {'ok/?/failed':>12} {'s/frame':>8}")
    total, rows = Score(), {}
    for folder in folders:
        score = scored(asked.sequences / folder.name, folder, max(asked.every, 1))
        rows[folder.name] = score.row()
        print(line(folder.name, rows[folder.name]), flush=True)
        total.add(score)
    rows["all"] = total.row()
    print(line("all", rows["all"]))
    print(f"largest turn: {total.turned or 'none'}")
    if asked.json is not None:
        asked.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
