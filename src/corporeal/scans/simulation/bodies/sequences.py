"""A virtual 4D capture of people: who does what, what the scanner loses, and every frame with its truth."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.spatial import cKDTree

from corporeal.geometry.normals import vertex_normals
from corporeal.scans.simulation.appearance import SKIN_TONES, skin_colours
from corporeal.scans.simulation.bodies.files import load_body_simulator
from corporeal.scans.simulation.bodies.motion import body_motion
from corporeal.scans.simulation.bodies.people import body_subject, share_of
from corporeal.scans.simulation.bodies.person import MovingPerson, PosedBody
from corporeal.scans.simulation.bodies.webs import finger_webs
from corporeal.scans.simulation.sampling_pattern import SamplingPattern, sampling_pattern
from corporeal.scans.simulation.scanner import RawCapture, SampledSurface, ScannerOptions, scan_surface

_MM = 1e3
# Asked for on the whole skin; a scan sees some 50,000 of them.
_POINTS = 62_000
# Three rings of seven stereo units and one overhead.
_UNITS = (
    *((360 / 7 * k, -8.0) for k in range(7)),
    *((360 / 7 * (k + 1 / 3), 18.0) for k in range(7)),
    *((360 / 7 * (k + 2 / 3), 45.0) for k in range(7)),
    (0.0, 85.0),
)
SCANNER = ScannerOptions(
    noise=1e-3, distance=2.6, baseline=0.35, pixels=800, units=_UNITS, reach=1.15, up="y"
)
# Skin of hands is seen by few pixels: its noise against the body's.
_HAND_NOISE = 1.5
# Gaps between fingers that are bridged, metres: drawn for every sequence and hand.
_WEBS = (2e-3, 12e-3)
_LOST_FRAMES = (5, 30)
# One loss for so many frames of a sequence, and frames before the first and between two.
_FRAMES_PER_LOSS, _PAUSE = 70, 12
_SEEN = 8e-3
PARTS = ("left_hand", "right_hand", "left_forearm", "right_forearm")
_HAND_BONES = ("wrist", "metacarpal", "finger")
_HANDS = {"left": slice(25, 40), "right": slice(40, 55)}


@dataclass(frozen=True)
class SequenceOptions:
    """What is captured.

    Attributes:
        sequences: how many.
        frames: of each, 60 a second.
        subjects: people; None for one in every two sequences.
        seed: everything follows from it.
    """

    sequences: int = 1
    frames: int = 200
    subjects: int | None = None
    seed: int = 0


@dataclass(frozen=True)
class Loss:
    """A part of the body that the scanner does not deliver, from a frame until before another."""

    part: str
    begin: int
    end: int


@dataclass(frozen=True)
class PlannedSequence:
    """One sequence to be made.

    Attributes:
        name: of its folder.
        subject: number of the person, 0 being the first.
        clip: name of the recorded motion.
        frames: how many.
        seed: of the capture.
        losses: what is missing on purpose, and when.
    """

    name: str
    subject: int
    clip: str
    frames: int
    seed: int
    losses: tuple[Loss, ...]

    def missing(self, frame: int) -> tuple[str, ...]:
        """Parts that are missing in a frame."""
        return tuple(loss.part for loss in self.losses if loss.begin <= frame < loss.end)


@dataclass(frozen=True, eq=False)
class FrameTruth:
    """What tracking never reads; metres, in the scan's frame.

    Attributes:
        template: (P, 3) true place of every vertex of the open body's template; for the eyes
            that on the head's skin which is next to them.
        placed: (P,) whether the vertex has a place on the simulator's skin.
        joints: (55, 3) in SMPL-X's order.
        seen: (P,) whether the scanner measured the skin beside the vertex.
        missing: parts that were left out on purpose.
    """

    template: Float[np.ndarray, "P 3"]
    placed: Bool[np.ndarray, " P"]
    joints: Float[np.ndarray, "55 3"]
    seen: Bool[np.ndarray, " P"]
    missing: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class SimulatedFrame:
    """Points (N, 3) in millimetres, faces (M, 3), colours (N, 3), and the truth."""

    points_mm: Float[np.ndarray, "N 3"]
    faces: Int[np.ndarray, "M 3"]
    colours: UInt8[np.ndarray, "N 3"]
    truth: FrameTruth


def plan_sequences(options: SequenceOptions) -> tuple[PlannedSequence, ...]:
    """All sequences; those of a smaller capture with as many people are the first of a larger one."""
    people = options.subjects or (options.sequences + 1) // 2
    clips = load_body_simulator().clips
    planned = []
    for number in range(options.sequences):
        subject = number % people
        clip = clips[(number + number // len(clips)) % len(clips)].name
        name = f"s{subject + 1:02d}-{clip}-{number + 1:02d}"
        generator = np.random.default_rng([options.seed, 12, number])
        losses = _losses(options.frames, generator)
        planned.append(PlannedSequence(name, subject, clip, options.frames, options.seed, losses))
    return tuple(planned)


def _losses(frames: int, generator: np.random.Generator) -> tuple[Loss, ...]:
    """A hand or forearm is lost now and then, one part at a time."""
    losses: list[Loss] = []
    free = _PAUSE
    while True:
        begin = free + int(generator.integers(_FRAMES_PER_LOSS))
        end = begin + int(generator.integers(_LOST_FRAMES[0], _LOST_FRAMES[1] + 1))
        part = PARTS[int(generator.integers(len(PARTS)))]
        # The data come back before the sequence ends.
        if end + _PAUSE > frames:
            return tuple(losses)
        losses.append(Loss(part, begin, end))
        free = end + _PAUSE


class SequenceSimulator:
    """Makes the frames of one sequence, in any order; each follows from the plan and its number alone."""

    def __init__(self, planned: PlannedSequence) -> None:
        self.planned = planned
        self._simulator = load_body_simulator()
        generator = np.random.default_rng([planned.seed, 13, zlib.crc32(planned.name.encode())])
        clip = next(clip for clip in self._simulator.clips if clip.name == planned.clip)
        subject = body_subject(self._simulator, planned.subject, planned.seed)
        motion = body_motion(self._simulator, clip, planned.frames, generator)
        self._person = MovingPerson(self._simulator, subject, motion)
        self._widest = {side: generator.uniform(*_WEBS) for side in _HANDS}
        self._tone = subject.tone
        normals = vertex_normals(self._person.rest, self._simulator.faces)
        self._colours = skin_colours(self._person.rest, normals, subject.tone, subject.seed)
        self._pattern = _pattern(planned.seed)
        self._parts = _parts(self._pattern)
        hands = self._parts["left_hand"] | self._parts["right_hand"]
        self._noise = np.where(hands, _HAND_NOISE, 1.0)

    def frame(self, number: int) -> SimulatedFrame:
        """Capture a frame."""
        planned = self.planned
        seed = [planned.seed, 14, zlib.crc32(planned.name.encode()), number]
        generator = np.random.default_rng(seed)
        posed, missing = self._person.posed(number), planned.missing(number)
        lost = np.zeros(len(self._pattern.faces), dtype=bool)
        for part in missing:
            lost |= self._parts[part]
        skin = SampledSurface(
            posed.vertices, self._simulator.faces, self._colours, self._pattern, lost, self._noise
        )
        capture = scan_surface(skin, self._webs(posed, missing), SCANNER, generator)
        return SimulatedFrame(
            _MM * capture.points, capture.faces, capture.colours, self._truth(posed, capture, missing)
        )

    def _webs(self, posed: PosedBody, missing: tuple[str, ...]) -> list[SampledSurface]:
        gone = {part.split("_")[0] for part in missing}
        sheets: list[SampledSurface] = []
        for side, joints in _HANDS.items():
            if side not in gone:
                sheets += finger_webs(posed.joints[joints], self._widest[side], SKIN_TONES[self._tone])
        return sheets

    def _truth(self, posed: PosedBody, capture: RawCapture, missing: tuple[str, ...]) -> FrameTruth:
        template = self._simulator.on_template(posed.vertices)
        own = capture.clean[capture.samples < len(self._pattern.faces)]
        distances = cKDTree(own).query(template, distance_upper_bound=_SEEN)[0]
        placed = self._simulator.template_placed
        return FrameTruth(template, placed, posed.joints, placed & np.isfinite(distances), missing)


@lru_cache(maxsize=1)
def _pattern(seed: int) -> SamplingPattern:
    """Where points fall on the skin; each scan moves them and shuffles their order."""
    simulator = load_body_simulator()
    generator = np.random.default_rng([seed, 15])
    return sampling_pattern(simulator.vertices, simulator.faces, _POINTS, generator)


def _parts(pattern: SamplingPattern) -> dict[str, Bool[np.ndarray, " n"]]:
    """Which of the pattern's points lie on hands, and which on hands with their forearms."""
    simulator = load_body_simulator()
    corners = simulator.faces[pattern.faces]
    parts = {}
    for side in _HANDS:
        ending = side[0].upper()
        bones = [bone for bone in simulator.bones if bone.endswith(f".{ending}")]
        hand = tuple(bone for bone in bones if bone.startswith(_HAND_BONES))
        arm = (*hand, *(bone for bone in bones if bone.startswith("lowerarm")))
        for part, chosen in ((f"{side}_hand", hand), (f"{side}_forearm", arm)):
            share = share_of(simulator, chosen)
            parts[part] = (pattern.barycentric * share[corners]).sum(1) > 0.5
    return parts
