import numpy as np
import pytest

from corporeal.view.frame_clock import FrameClock


def test_it_stands_until_it_is_played():
    clock = FrameClock(10, 60.0)
    assert [clock.frame(now) for now in (0.0, 1.0, 100.0)] == [0, 0, 0]
    assert not clock.playing and clock.next_change(5.0) is None


@pytest.mark.parametrize("speed", [1.0, 0.5, 0.25])
def test_frames_follow_time_at_every_speed_whatever_moments_are_asked(speed, rng):
    clock = FrameClock(1000, 60.0)
    clock.set_speed(speed, 0.0)
    clock.toggle(7.0)
    for passed in np.sort(rng.uniform(0, 10, 200)):
        assert clock.frame(7.0 + passed) == int(passed * 60.0 * speed)


def test_the_next_change_is_when_another_frame_is_to_be_seen(rng):
    clock = FrameClock(50, 24.0)
    clock.toggle(0.0)
    for now in rng.uniform(0, 20, 200):
        pause = clock.next_change(now)
        assert 0 < pause <= 1 / 24 + 1e-9
        assert clock.frame(now + pause - 1e-6) == clock.frame(now)
        assert clock.frame(now + pause + 1e-6) == (clock.frame(now) + 1) % 50


def test_it_loops_or_stops_at_the_last_frame_and_begins_anew():
    clock = FrameClock(10, 10.0)
    clock.toggle(0.0)
    assert clock.frame(1.25) == 2
    clock.set_loop(False, 1.25)
    assert clock.frame(1.25) == 2 and clock.playing
    assert clock.frame(9.0) == 9 and not clock.playing
    clock.toggle(20.0)
    assert clock.frame(20.0) == 0 and clock.frame(20.35) == 3


def test_pause_step_and_go():
    clock = FrameClock(10, 10.0)
    clock.toggle(0.0)
    clock.toggle(0.55)
    assert not clock.playing and clock.frame(30.0) == 5
    clock.step(1, 30.0)
    clock.step(1, 30.0)
    assert clock.frame(31.0) == 7
    clock.go(99)
    assert clock.frame(31.0) == 9
    clock.step(1, 31.0)
    assert clock.frame(31.0) == 0
    clock.step(-1, 31.0)
    assert clock.frame(31.0) == 9
    clock.set_loop(False, 31.0)
    clock.step(1, 31.0)
    assert clock.frame(31.0) == 9
    clock.toggle(31.0)
    clock.step(2, 31.05)
    assert not clock.playing and clock.frame(40.0) == 2


def test_another_speed_makes_no_jump():
    clock = FrameClock(100, 10.0)
    clock.toggle(0.0)
    clock.set_speed(0.25, 2.05)
    assert clock.frame(2.05) == 20
    assert clock.frame(2.05 + 4.0) == 30


def test_frames_come_and_go():
    clock = FrameClock(10, 10.0)
    clock.go(9)
    clock.resize(20, 0.0)
    assert clock.frame(0.0) == 9 and clock.count == 20
    clock.resize(4, 0.0)
    assert clock.frame(0.0) == 3
    clock.toggle(0.0)
    clock.resize(8, 0.25)
    assert clock.playing and clock.frame(0.25) == 1


@pytest.mark.parametrize(("count", "fps"), [(0, 60.0), (5, 0.0), (5, -1.0), (5, float("nan"))])
def test_a_clock_without_frames_or_speed_is_refused(count, fps):
    with pytest.raises(ValueError, match="needs frames"):
        FrameClock(count, fps)
