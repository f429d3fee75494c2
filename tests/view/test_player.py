import threading

import numpy as np
import pytest

from corporeal.view.player import BLOCK, Player
from corporeal.view.track import FrameRow, ShownScan, problem_stretches, stance_of

PATIENCE = 30.0


class MadeTrack:
    """Vertices tell their frame, and so do the points of scans; scans wait until they are let."""

    name, note, fps = "made", "", 10.0

    def __init__(self, statuses):
        self.statuses, self.later, self.changed = list(statuses), [], False
        self.let = threading.Event()
        self.blocks, self.scans = [], []

    @property
    def rows(self):
        words = {"o": "ok", "d": "doubtful", "f": "failed"}
        return [
            FrameRow(f"{i:04d}", words[letter], "", None if letter == "f" else 2.0)
            for i, letter in enumerate(self.statuses)
        ]

    def faces(self):
        return np.array([[0, 1, 2]])

    def vertices(self, start, stop):
        self.blocks.append((start, stop))
        frames = np.arange(start, stop, dtype=np.float32)
        return np.broadcast_to(frames[:, None, None], (len(frames), 3, 3)).copy()

    def scan(self, index):
        assert self.let.wait(PATIENCE)
        self.scans.append(index)
        if index == 2:
            return ShownScan.missing("no scan")
        return ShownScan(np.full((4, 3), index, np.float32), np.zeros((4, 3), np.uint8))

    def stance(self):
        return stance_of(np.eye(3, dtype=np.float32), np.array([0.0, 1, 0]), np.array([0.0, 0, 1]))

    def release(self):
        pass

    def refresh(self):
        self.statuses += self.later
        return self.changed


@pytest.fixture
def played():
    """Makes players, and closes them; ``loaded`` counts their scans."""
    players = []

    def make(track, **options):
        player = Player(track, lambda index: loaded.release(), **options)
        players.append((player, track))
        return player

    loaded = threading.Semaphore(0)
    make.loaded = loaded
    yield make
    for player, track in players:
        track.let.set()
        player.close(PATIENCE)


def wait(semaphore, count):
    for _ in range(count):
        assert semaphore.acquire(timeout=PATIENCE)


def test_every_frame_has_its_vertices_and_is_posed_in_blocks(played):
    track = MadeTrack("o" * (2 * BLOCK + 5))
    player = played(track)
    for index in (0, 7, BLOCK, 2 * BLOCK + 4, BLOCK - 1):
        player.clock.go(index)
        frame = player.at(0.0)
        assert frame.index == index and frame.row.name == f"{index:04d}"
        np.testing.assert_array_equal(frame.vertices, np.full((3, 3), index))
    assert sorted(set(track.blocks)) == [(0, BLOCK), (BLOCK, 2 * BLOCK), (2 * BLOCK, 2 * BLOCK + 5)]


def test_a_scan_is_never_waited_for_and_comes_when_it_is_read(played):
    track = MadeTrack("oooo")
    player = played(track)
    frame = player.at(0.0)
    assert frame.scan is None and frame.scan_index == 0
    track.let.set()
    wait(played.loaded, 4)
    assert track.scans == [0, 1, 2, 3]
    for index in (0, 1, 3):
        player.clock.go(index)
        frame = player.at(0.0)
        assert frame.scan_index == index and (frame.scan.points == index).all()
    player.clock.go(2)
    assert player.at(0.0).scan.note == "no scan"


def test_while_it_plays_the_last_scan_stands_but_not_for_long_and_not_when_it_stands(played):
    track = MadeTrack("o" * 40)
    player = played(track, scans_kept=1)
    player.at(0.0)
    track.let.set()
    wait(played.loaded, 1)
    track.let.clear()
    player.clock.toggle(0.0)
    frame = player.at(0.35)
    assert (frame.index, frame.scan_index) == (3, 0) and (frame.scan.points == 0).all()
    assert player.at(1.0).scan is None
    player.clock.go(3)
    assert player.at(2.0).scan is None


def test_memory_does_not_grow_with_the_length(played):
    track = MadeTrack("o" * 500)
    track.let.set()
    player = played(track, scans_kept=7)
    for index in range(0, 500, 3):
        player.clock.go(index)
        player.at(0.0)
        wait(played.loaded, 1)
        assert player.scans_there <= 7


def test_when_it_plays_faster_than_scans_are_read_those_are_read_that_can_be_there_in_time(played):
    player = played(MadeTrack("o" * 100))
    player._scans.seconds = 0.33
    player.clock.toggle(0.0)
    ahead = list(player._scans_ahead(13))
    assert ahead[:5] == [16, 20, 24, 28, 32]
    # All others follow, in order, round the end.
    assert ahead[len(ahead) - 100 :] == [*range(13, 100), *range(13)]
    player.clock.set_loop(False, 1.0)
    assert max(player._scans_ahead(13)) == 99 and min(player._scans_ahead(13)) == 13


def test_scans_that_are_not_shown_are_not_read(played):
    track = MadeTrack("ooo")
    track.let.set()
    player = played(track)
    player.scans_wanted = False
    player.at(0.0)
    player.scans_wanted = True
    assert track.scans == []
    player.at(0.0)
    wait(played.loaded, 3)
    assert track.scans == [0, 1, 2]


def test_problems_are_gone_to_by_stretches_round_the_ends(played):
    player = played(MadeTrack("ddoofdddo"))
    assert problem_stretches(player.track.rows) == [(0, 1), (4, 4), (5, 7)]
    for by, wanted in ((1, [4, 5, 0, 4]), (-1, [0, 5, 4, 0])):
        for index in wanted:
            found = player.next_problem(by, 0.0)
            assert found == index
            player.clock.go(found)
    assert played(MadeTrack("ooo")).next_problem(1, 0.0) is None


def test_refresh_shows_later_frames_and_reads_what_was_missing(played):
    track = MadeTrack("oooo")
    track.let.set()
    player = played(track)
    player.at(0.0)
    wait(played.loaded, 4)
    player.clock.go(3)
    track.later = list("ood")
    assert player.refresh(0.0) == 3
    assert player.at(0.0).index == 3
    player.clock.go(6)
    frame = player.at(0.0)
    assert frame.row.status == "doubtful" and (frame.vertices == 6).all()
    wait(played.loaded, 4)
    # The missing one and the new ones; a frame that changed costs all.
    assert sorted(track.scans[4:]) == [2, 4, 5, 6]
    track.later, track.changed = [], True
    player.refresh(0.0)
    player.at(0.0)
    wait(played.loaded, 7)
    assert sorted(track.scans[8:]) == list(range(7))


def test_a_stance_is_level_on_the_axis_that_is_closest_to_up(rng):
    vertices = rng.uniform(-1, 1, (50, 3)).astype(np.float32)
    stance = stance_of(vertices, np.array([0.1, 0.2, -0.97]), np.array([0.0, -0.9, -0.3]))
    np.testing.assert_array_equal(stance.up, [0, 0, -1])
    np.testing.assert_allclose(stance.front, [0, -1, 0], atol=1e-12)
    np.testing.assert_allclose(stance.floor, -vertices[:, 2].max())
    np.testing.assert_allclose(stance.size, np.ptp(vertices, axis=0).max())
