"""Learn a model of something that is not a hand: a simulated arm with a biceps and a forearm that twists.

The flesh below is what linear skinning cannot do: the elbow bends along an arc and keeps the area of its
section, the twist of the wrist spreads over the forearm, and the biceps grows with the bend. The learner is
given surfaces, rough poses, a mesh and the places of three joints, nothing else.
"""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from corporeal.export.overview import error_colours
from corporeal.export.sheets import (
    Layout,
    Tile,
    View,
    blank_sheet,
    put_tile,
    sheet_camera,
    sheet_pixels,
    write_sheet,
)
from corporeal.learning.learn import learn_model
from corporeal.learning.options import LearningOptions
from corporeal.learning.personal import personal_model
from corporeal.learning.start_model import start_model
from corporeal.learning.training_set import TrainingSet
from corporeal.model.files import save_model
from corporeal.model.jacobian import evaluate, linearise

SUBJECTS, POSES, UNSEEN = 8, 25, 3
SIDES, RINGS, NOISE = 16, 41, 3e-4
NAMES, PARENTS = ("shoulder", "elbow", "wrist"), (-1, 0, 1)


class Person(NamedTuple):
    """Lengths of upper arm, forearm and hand, and girth against the average; metres."""

    upper: float = 0.28
    fore: float = 0.25
    hand: float = 0.10
    girth: float = 1.0


class Bend(NamedTuple):
    """Flexion of the elbow, twist of the forearm, flexion and tilt of the wrist, all in radians."""

    elbow: float = 0.0
    twist: float = 0.0
    wrist: float = 0.0
    tilt: float = 0.0


def ramp(along: np.ndarray, start: float, end: float) -> np.ndarray:
    share = np.clip((along - start) / (end - start), 0, 1)
    return share * share * (3 - 2 * share)


def flesh(person: Person, bend: Bend) -> np.ndarray:
    """The arm's surface, (V, 3): along -x at rest, bent towards +z."""
    elbow, wrist = person.upper, person.upper + person.fore
    along = np.interp(np.linspace(0, 1, RINGS), [0, 0.42, 0.84, 1], [0, elbow, wrist, wrist + person.hand])
    at_elbow, at_wrist = ramp(along, elbow - 0.04, elbow + 0.04), ramp(along, wrist - 0.03, wrist + 0.03)
    twisted = bend.twist * np.clip((along - elbow) / person.fore, 0, 1)
    frames = (
        Rotation.from_euler("y", bend.elbow * at_elbow[:, None])
        * Rotation.from_euler("x", twisted[:, None])
        * Rotation.from_euler("YZ", at_wrist[:, None] * [bend.wrist, bend.tilt])
    )
    centres = cumulative_trapezoid(frames.apply([-1.0, 0, 0]), along, axis=0, initial=0)
    angles = 2 * np.pi * np.arange(SIDES) / SIDES
    knots = [0, 0.5 * elbow, elbow, elbow + 0.3 * person.fore, wrist, wrist + person.hand]
    radius = person.girth * np.interp(along, knots, [0.048, 0.045, 0.038, 0.04, 0.027, 0.024])
    biceps = 0.014 * np.sin(bend.elbow / 2) ** 2 * np.exp(-(((along - 0.5 * elbow) / 0.07) ** 2))
    wide = 1 + 0.25 * np.sin(bend.elbow / 2) ** 2 * np.exp(-(((along - elbow) / 0.05) ** 2))
    swollen = radius[:, None] + biceps[:, None] * np.clip(np.cos(angles), 0, 1) ** 2
    sections = np.stack(
        [0 * swollen, wide[:, None] * swollen * np.sin(angles), swollen * np.cos(angles) / wide[:, None]],
        axis=2,
    )
    rings = centres[:, None] + np.einsum("rab,rsb->rsa", frames.as_matrix(), sections)
    ends = rings[[0, -1]].mean(axis=1)
    return np.concatenate([rings.reshape(-1, 3), ends])


def mesh_faces() -> np.ndarray:
    first = np.arange((RINGS - 1) * SIDES)
    other = first - first % SIDES + (first + 1) % SIDES
    side = np.concatenate(
        [np.stack([first, other, first + SIDES], 1), np.stack([other, other + SIDES, first + SIDES], 1)]
    )
    around, last = np.arange(SIDES), (RINGS - 1) * SIDES
    after = (around + 1) % SIDES
    top = np.stack([np.full(SIDES, last + SIDES), after, around], 1)
    tip = np.stack([np.full(SIDES, last + SIDES + 1), last + around, last + after], 1)
    return np.concatenate([side, top, tip])


def capture(people: list[Person], poses: int, rng: np.random.Generator) -> TrainingSet:
    """Noisy surfaces in any place, joint rotations some degrees wrong; everyone's first pose is straight."""
    surfaces, rotations, places = [], [], []
    for person in people:
        for pose in range(poses):
            bend = Bend(*(rng.uniform([0, -1.2, -0.9, -0.4], [1.6, 1.2, 0.9, 0.4]) * (pose > 0)))
            root, place = 0.3 * rng.standard_normal(3), 0.2 * rng.standard_normal(3)
            surface = Rotation.from_rotvec(root).apply(flesh(person, bend)) + place
            surfaces.append(surface + NOISE * rng.standard_normal(surface.shape))
            hand = Rotation.from_euler("XYZ", [bend.twist, bend.wrist, bend.tilt]).as_rotvec()
            rotations.append(np.stack([root, [0, bend.elbow, 0], hand]) + 0.05 * rng.standard_normal((3, 3)))
            places.append(place)
    owners = tuple(f"s{number}" for number in range(len(people)) for _ in range(poses))
    names = tuple(f"{owner}_{index}" for index, owner in enumerate(owners))
    shapes = np.zeros((len(names), 1))
    return TrainingSet(
        np.stack(surfaces),
        np.stack(rotations),
        np.stack(places),
        shapes,
        owners,
        owners,
        ("",) * len(names),
        names,
    )


def fitted(model, scans: TrainingSet, index: int) -> np.ndarray:
    """The model's surface after its pose and place were fitted to a registration."""

    def posed(numbers, of=evaluate):
        return of(model, np.zeros(0), numbers[3:].reshape(-1, 3), numbers[:3])

    target = scans.vertices[index]
    solved = least_squares(
        lambda numbers: (posed(numbers).vertices - target).ravel(),
        np.concatenate([scans.translations[index], scans.poses[index].ravel()]),
        jac=lambda numbers: posed(numbers, linearise).vertex_jacobian.reshape(target.size, -1),
    )
    return posed(solved.x).vertices


def pairs(found: list[np.ndarray]) -> zip:
    return zip(found, unseen.vertices, strict=True)


rng = np.random.default_rng(7)
people = [
    Person(*(np.array(Person()) * (1 + [0.08, 0.08, 0.08, 0.12] * rng.standard_normal(4))))
    for _ in range(SUBJECTS)
]
training, unseen = capture(people, POSES, rng), capture(people, UNSEEN, rng)

average = Person()
joints = np.array([[-0.02, 0, 0], [-average.upper, 0, 0], [-average.upper - average.fore, 0, 0]])
start = start_model(flesh(average, Bend()), mesh_faces(), joints, PARENTS, NAMES, name="arm")
# A corrective costs the square of its distance from its joint: the default is for a hand, and an arm is
# larger. These surfaces have little noise besides, so that little is held back.
free = LearningOptions(corrective_strength=0.02, template_strength=0.02)
learned = learn_model(training, start, free)
without = learn_model(training, start, replace(free, correctives=False))
print(f"learned from {len(training)} registrations of {SUBJECTS} arms with {start.vertex_count} vertices")

surfaces: dict[str, list[np.ndarray]] = {
    "rough weights": [],
    "without correctives": [],
    "with correctives": [],
}
for index, owner in enumerate(unseen.hands):
    for label, result, base in (
        ("rough weights", without, start),
        ("without correctives", without, without.model),
        ("with correctives", learned, learned.model),
    ):
        template = result.templates[result.hands.index(owner)]
        surfaces[label].append(fitted(personal_model(base, template), unseen, index))
print(f"unseen poses, pose and place fitted to a fixed personal template, {len(unseen)} surfaces:")
for label, found in surfaces.items():
    misses = 1e3 * np.linalg.norm(np.stack(found) - unseen.vertices, axis=2)
    print(f"  {label:20s} mean {misses.mean():.2f} mm, largest {misses.max():.1f} mm")
print(f"  {'noise alone':20s} mean {1e3 * NOISE * np.sqrt(8 / np.pi):.2f} mm")

# The two surfaces that linear skinning meets worst, errors from blue (none) to red (3 mm and more).
worst = np.argsort([-np.abs(found - scan).mean() for found, scan in pairs(surfaces["without correctives"])])[
    :2
]
layout = Layout((300, 250), ("registration", *surfaces), ("", ""))
page = blank_sheet(layout)
for row, index in enumerate(worst):
    upright = Rotation.from_rotvec(unseen.poses[index, 0]).inv()
    scan = unseen.vertices[index]
    camera = sheet_camera(
        layout, View("above", np.array([0, -1.0, -0.2]), np.array([0, 0, 1.0])), [upright.apply(scan)]
    )
    put_tile(page, layout, Tile(upright.apply(scan), start.faces), camera, row, 0)
    for column, found in enumerate(surfaces.values(), start=1):
        colours = error_colours(1e3 * np.linalg.norm(found[index] - scan, axis=1))
        put_tile(page, layout, Tile(upright.apply(found[index]), start.faces, colours), camera, row, column)

folder = Path("demo-out")
folder.mkdir(exist_ok=True)
write_sheet(folder / "arm.png", sheet_pixels(page))
save_model(learned.model, folder / "arm.npz")
print("wrote", folder / "arm.png", folder / "arm.npz")
