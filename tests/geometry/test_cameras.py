import numpy as np
import pytest

from corporeal.geometry.cameras import Pinhole

DOWN_Z = np.array([0.0, 0.0, 1.0])
UP_Y = np.array([0.0, 1.0, 0.0])


def random_camera(rng: np.random.Generator, size: tuple[int, int] = (320, 240)) -> Pinhole:
    return Pinhole.look_at(rng.normal(size=3) * 3, rng.normal(size=3) * 0.1, rng.normal(size=3), 0.7, size)


def test_unproject_is_the_inverse_of_project(rng):
    camera = random_camera(rng)
    points = rng.normal(size=(50, 3)) * 0.2
    pixels, depth = camera.project(points)
    np.testing.assert_allclose(camera.unproject(pixels, depth), points, atol=1e-13)
    homogeneous = np.c_[points, np.ones(50)] @ camera.projection.T
    np.testing.assert_allclose(homogeneous[:, :2] / homogeneous[:, 2:], pixels, atol=1e-9)


def test_look_at_puts_the_target_in_the_middle_and_up_at_the_top():
    eye, target = np.array([1.0, 2.0, -3.0]), np.array([0.3, 0.1, 0.2])
    camera = Pinhole.look_at(eye, target, UP_Y, 0.5, (320, 200))
    pixels, depth = camera.project(np.stack([target, target + 0.1 * UP_Y]))
    np.testing.assert_allclose(pixels[0], [160, 100], atol=1e-10)
    np.testing.assert_allclose(depth[0], np.linalg.norm(target - eye), atol=1e-12)
    np.testing.assert_allclose(camera.eye, eye, atol=1e-12)
    assert pixels[1, 1] < 100 and abs(pixels[1, 0] - 160) < 1e-9
    rotation = camera.T_camera_world[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_x_is_right_and_y_is_down():
    camera = Pinhole.look_at(np.zeros(3), DOWN_Z, -UP_Y, 0.5, (100, 100))
    pixels, _ = camera.project(np.array([[0.1, 0.0, 1.0], [0.0, 0.1, 1.0]]))
    assert pixels[0, 0] > 50 and pixels[1, 1] > 50


def test_points_behind_have_no_pixel():
    camera = Pinhole.look_at(np.zeros(3), DOWN_Z, UP_Y, 0.5, (100, 100))
    pixels, depth = camera.project(np.array([[0.0, 0.0, -1.0]]))
    assert np.isnan(pixels).all() and depth[0] == -1.0


@pytest.mark.parametrize("size", [(200, 200), (320, 200), (150, 300)])
@pytest.mark.parametrize("fill", [0.4, 1.0])
def test_fit_to_frame_is_tight_and_centred(rng, size, fill):
    points = rng.normal(size=(300, 3)) * [0.05, 0.1, 0.2]
    camera = Pinhole.fit_to_frame(
        points, rng.normal(size=3), rng.normal(size=3), fov=0.6, size=size, fill=fill
    )
    pixels, depth = camera.project(points)
    assert depth.min() > 0
    offset = (pixels - camera.centre) / (0.5 * fill * np.asarray(size))
    low, high = offset.min(0), offset.max(0)
    assert max(high.max(), -low.min()) == pytest.approx(1.0, abs=1e-9)  # touches the frame, never leaves it
    tight = int(np.argmax(np.maximum(high, -low)))
    np.testing.assert_allclose(
        high[tight], -low[tight], atol=1e-9
    )  # touches it on both sides: no closer fits


def test_a_camera_without_an_orientation_is_refused():
    with pytest.raises(ValueError, match="up"):
        Pinhole.look_at(np.zeros(3), DOWN_Z, 2 * DOWN_Z, 0.5, (10, 10))
    with pytest.raises(ValueError, match="up"):
        Pinhole.look_at(DOWN_Z, DOWN_Z, UP_Y, 0.5, (10, 10))
    with pytest.raises(ValueError, match="at least one"):
        Pinhole.fit_to_frame(np.zeros((0, 3)), DOWN_Z, UP_Y, fov=0.5, size=(10, 10), fill=1.0)
