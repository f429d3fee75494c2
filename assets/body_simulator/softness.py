"""Where flesh follows late (belly, breasts, buttocks) and where muscles swell (biceps, calves)."""

from __future__ import annotations

import numpy as np

SOFT = ("belly", "left_breast", "right_breast", "left_buttock", "right_buttock")
MUSCLES = ("left_biceps", "right_biceps", "left_calf", "right_calf")
_BELLY, _BREAST, _BUTTOCK = np.array([0.11, 0.1, 0.09]), np.full(3, 0.055), np.full(3, 0.08)


def soft_masks(
    vertices: np.ndarray, heads: np.ndarray, bones: tuple[str, ...], weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Masks (V, 5) of soft parts and (V, 4) of muscles, 0 to 1, on the mean person at rest."""
    at = {bone: heads[number] for number, bone in enumerate(bones)}
    torso = 1 - sum(
        weights[:, number] for number, bone in enumerate(bones) if bone.startswith(("upperarm", "lowerarm"))
    )
    soft = []
    middle = (at["spine04"] + at["spine03"]) / 2
    soft.append(_bump(vertices, _front(vertices, [0, middle[1]], 0.03), _BELLY))
    for x in (1, -1):
        chest = (at["spine01"] + at["spine02"]) / 2
        soft.append(_bump(vertices, _front(vertices, [0.085 * x, chest[1]], 0.05), _BREAST))
    for side in "LR":
        hip = at[f"upperleg01.{side}"]
        back = _front(vertices * [1, 1, -1], [hip[0], hip[1] - 0.02], 0.05) * [1, 1, -1]
        soft.append(_bump(vertices, back, _BUTTOCK))
    muscles = []
    for names in (("upperarm01", "lowerarm01", 1.0), ("lowerleg01", "foot", -1.0)):
        for side in "LR":
            muscles.append(_muscle(vertices, at, side, names))
    return np.stack(soft, axis=1) * torso[:, None], np.stack(muscles, axis=1)


def _front(vertices: np.ndarray, place: list[float], radius: float) -> np.ndarray:
    """The foremost vertex within a radius of (x, y)."""
    near = np.linalg.norm(vertices[:, :2] - place, axis=1) < radius
    return vertices[np.flatnonzero(near)[vertices[near, 2].argmax()]]


def _bump(vertices: np.ndarray, centre: np.ndarray, widths: np.ndarray) -> np.ndarray:
    return np.exp(-0.5 * np.sum(((vertices - centre) / widths) ** 2, axis=1))


def _muscle(vertices: np.ndarray, at: dict, side: str, names: tuple[str, str, float]) -> np.ndarray:
    """On the belly of a muscle between two bones' heads: the front of the upper arm, the back of the calf."""
    start, end = at[f"{names[0]}.{side}"], at[f"{names[1]}.{side}"]
    axis = end - start
    share = (vertices - start) @ axis / (axis @ axis)
    away = vertices - start - share[:, None] * axis
    distance = np.linalg.norm(away, axis=1)
    facing = np.clip(names[2] * away[:, 2] / np.maximum(distance, 1e-6), 0, 1)
    place, width = (0.55, 0.18) if names[2] > 0 else (0.3, 0.16)
    return np.exp(-0.5 * ((share - place) / width) ** 2) * facing * (distance < 0.11)
