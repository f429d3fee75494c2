"""Animated sequences: read back as a viewer would, compared with the model at its keys, and validated."""

from dataclasses import replace

import numpy as np
import pytest

from corporeal.export.animation import AnimationOptions, write_animation
from corporeal.export.gltf_check import GlbFile, largest_track_errors_mm, vertices_at
from corporeal.export.principal_correctives import pose_features, principal_correctives
from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate

FRAMES, FPS = 40, 30.0


def walk(model, rng, frames=FRAMES, size=0.5):
    """A smooth motion of few degrees of freedom, as motion is, in every joint."""
    phase = np.linspace(0, 2 * np.pi, frames)[:, None, None]
    wide, shift = (
        size * rng.standard_normal((model.joint_count, 3)),
        rng.uniform(0, 6, (model.joint_count, 3)),
    )
    poses = wide * np.sin(phase + shift)
    return poses, np.cumsum(0.02 * rng.standard_normal((frames, 3)), axis=0)


@pytest.fixture
def track(model, rng):
    return walk(model, rng)


def test_every_key_is_within_the_tolerance_that_was_asked_for(model, track, rng, tmp_path):
    shape = rng.standard_normal(model.shape_count)
    arguments = (model, shape, *track)
    options = AnimationOptions(tolerance=0.2e-3)
    summary = write_animation(tmp_path / "a" / "track.glb", *arguments, FPS, options)
    errors = largest_track_errors_mm(tmp_path / "a" / "track.glb", *arguments, frames=range(FRAMES))
    assert 0 < summary.corrective_targets < 24 and summary.largest_joint_share_lost == 0
    # The stated error holds before skinning, which cannot make it larger; float32 adds a micrometre.
    assert max(errors.values()) <= summary.largest_corrective_error_mm + 0.001 <= 0.2 + 0.001
    assert max(errors.values()) > 0.2 * summary.largest_corrective_error_mm
    assert summary.largest_corrective_mm > 5
    without = write_animation(tmp_path / "b.glb", *arguments, FPS, replace(options, most_targets=0))
    assert without.largest_corrective_error_mm == summary.largest_corrective_mm
    assert max(largest_track_errors_mm(tmp_path / "b.glb", *arguments, frames=range(FRAMES)).values()) > 1


def test_fewest_targets_are_taken_and_too_few_are_said(model, track):
    poses = track[0]
    enough = principal_correctives(model, poses, most=24, tolerance=0.5e-3)
    count = len(enough.targets.names)
    fewer = principal_correctives(model, poses, most=count - 1, tolerance=0.5e-3)
    assert len(fewer.targets.names) == count - 1
    assert fewer.largest_error_mm > 0.5 >= enough.largest_error_mm
    # As good as the principal directions of the offsets themselves.
    offsets = pose_features(poses) @ model.pose_directions.reshape(3 * model.vertex_count, -1).T
    right = np.linalg.svd(offsets, full_matrices=False)[2][:count]
    left = (offsets - offsets @ right.T @ right).reshape(FRAMES, -1, 3)
    assert enough.largest_error_mm == pytest.approx(
        1e3 * np.linalg.norm(left, axis=2).max(), abs=5e-3 * count
    )
    assert np.abs(enough.targets.weights).max() == pytest.approx(1)


def test_keys_are_the_frames_and_it_opens_in_the_first(model, track, tmp_path):
    write_animation(tmp_path / "track.glb", model, np.zeros(0), *track, FPS)
    glb = GlbFile.read(tmp_path / "track.glb")
    np.testing.assert_allclose(glb.key_times, np.arange(FRAMES) / FPS, rtol=1e-6)
    first = evaluate(model, np.zeros(0), track[0][0], track[1][0]).vertices
    assert 1e3 * np.linalg.norm(vertices_at(glb, None) - first, axis=1).max() < 0.5
    extras = glb.document["asset"]["extras"]["corporeal"]
    assert extras["keys"] == FRAMES and extras["largest_corrective_error_mm"] <= 0.5
    assert extras["corrective_targets"] == len(glb.primitive["targets"])


def test_a_vertex_keeps_its_four_largest_joints_and_what_is_lost_is_said(dense_model, rng, tmp_path):
    poses, translations = walk(dense_model, rng)
    summary = write_animation(tmp_path / "track.glb", dense_model, np.zeros(0), poses, translations, FPS)
    glb = GlbFile.read(tmp_path / "track.glb")
    assert "JOINTS_1" not in glb.primitive["attributes"]
    smallest = np.sort(dense_model.skinning_weights, axis=1)[:, 0].max()
    assert summary.largest_joint_share_lost == pytest.approx(smallest, rel=1e-9)
    np.testing.assert_allclose(glb.array(glb.primitive["attributes"]["WEIGHTS_0"]).sum(axis=1), 1, rtol=1e-6)


def test_a_model_without_correctives_and_a_single_frame(model, track, tmp_path, khronos_validator):
    bare = model.replace(pose_directions=np.zeros((model.vertex_count, 3, 0)))
    poses, translations = track
    for name, given, frames in (("bare", bare, FRAMES), ("single", model, 1)):
        arguments = (given, np.zeros(0), poses[:frames], translations[:frames])
        path = tmp_path / f"{name}.glb"
        write_animation(path, *arguments, FPS)
        assert max(largest_track_errors_mm(path, *arguments, frames=range(frames)).values()) < 0.5
        issues = khronos_validator(path)["issues"]
        assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


def test_local_targets_are_stored_sparse_and_valid(model, track, tmp_path, khronos_validator):
    local = model.pose_directions.copy()
    local[20:] = 0
    model = model.replace(pose_directions=local)
    write_animation(tmp_path / "track.glb", model, np.zeros(0), *track, FPS)
    glb = GlbFile.read(tmp_path / "track.glb")
    accessors = [glb.document["accessors"][target["POSITION"]] for target in glb.primitive["targets"]]
    assert accessors and all(accessor["sparse"]["count"] <= 20 for accessor in accessors)
    errors = largest_track_errors_mm(tmp_path / "track.glb", model, np.zeros(0), *track, frames=[0, 7, 39])
    assert max(errors.values()) < 0.5
    issues = khronos_validator(tmp_path / "track.glb")["issues"]
    assert issues["numErrors"] == issues["numWarnings"] == 0, issues["messages"]


@pytest.mark.slow
def test_the_open_body(rng, tmp_path, khronos_validator):
    body = open_model("body")
    poses, translations = walk(body, rng, size=0.2)
    path = tmp_path / "track.glb"
    summary = write_animation(path, body, np.zeros(0), poses, translations, 60.0)
    errors = largest_track_errors_mm(path, body, np.zeros(0), poses, translations, frames=[0, 13, 39])
    assert max(errors.values()) <= summary.largest_corrective_error_mm + 0.001 < 0.5 + 0.001
    assert summary.bytes == path.stat().st_size < 8e6
    report = khronos_validator(path)
    assert report["issues"]["numErrors"] == report["issues"]["numWarnings"] == 0, report["issues"]["messages"]
    assert report["info"]["hasMorphTargets"] and report["info"]["hasSkins"]


def test_wrong_calls_are_refused_and_leave_nothing(model, track, tmp_path):
    poses, translations = track
    for arguments, words in (
        ((np.zeros(0), poses[:, :3], translations, FPS), r"poses: expected \(frames, 5, 3\)"),
        ((np.zeros(0), poses, translations[1:], FPS), r"translations: expected \(40, 3\)"),
        ((np.zeros(9), poses, translations, FPS), "shape: 9 coefficients for 4"),
        ((np.zeros(0), poses * np.nan, translations, FPS), "poses: holds NaN"),
        ((np.zeros(0), poses, translations, 0.0), "fps: expected a positive number"),
    ):
        with pytest.raises(ValueError, match=words):
            write_animation(tmp_path / "track.glb", model, *arguments)
    assert not list(tmp_path.iterdir())
