"""First joints come from what moves with a bone; skin that slides over it has no say in them."""

import dataclasses

import numpy as np
import pytest

from corporeal.learning import bone_motions
from corporeal.learning.learn import learn_model
from corporeal.learning.options import LearningOptions

SLIDING, SLIDE = 0.25, 3e-3


@pytest.fixture
def sliding(known_tube):
    """The known tube's registrations, a quarter of the skin elsewhere on its bone in each; which skin."""
    training, rng = known_tube.training, np.random.default_rng(3)
    slides = rng.random(training.vertices.shape[1]) < SLIDING
    moved = SLIDE * rng.standard_normal((len(training), 1, 3)) * slides[:, None]
    return dataclasses.replace(training, vertices=training.vertices + moved), slides


def test_the_witnesses_of_a_bone_do_not_slide(known_tube, sliding, monkeypatch):
    training, slides = sliding
    witnesses, chosen = bone_motions._witnesses, []

    def told(state, part):
        vertices = witnesses(state, part)
        chosen.append(part.priors.templates[0][vertices])
        return vertices

    monkeypatch.setattr(bone_motions, "_witnesses", told)
    learn_model(training, known_tube.start, LearningOptions(sweeps=1, correctives=False))
    assert len(chosen) == 2 and len(chosen[1]) >= 3 * bone_motions._FEWEST
    apart = np.linalg.norm(known_tube.start.template - chosen[1][:, None], axis=2)
    assert apart.min(axis=1).max() < 1e-12
    assert not slides[apart.argmin(axis=1)].any()
