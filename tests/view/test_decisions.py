import json
import os

import numpy as np
import pytest

from corporeal.registration.session.files import read_decisions
from corporeal.view.curation import Curation, CurationItem, ScanDisplay
from corporeal.view.files import DecisionFileError, DecisionLog


def test_random_decisions_agree_with_a_plain_list(rng, tmp_path):
    """Decide, undo and reopen at random; the oracle keeps whole states on a stack."""
    path, states = tmp_path / "d.jsonl", [{}]
    log = DecisionLog(path)
    for _ in range(300):
        draw = rng.random()
        if draw < 0.3:
            assert (log.undo() is None) == (len(states) == 1)
            states = states[:-1] or states
        elif draw < 0.4:
            log = DecisionLog(path)
        else:
            name, verdict = f"s{rng.integers(5)}", ("accept", "reject")[rng.integers(2)]
            log.decide(name, verdict)
            states.append(states[-1] | {name: verdict})
        assert log.history.current == states[-1]
    # What registration reads in its second round is the same.
    assert read_decisions(tmp_path) == {}
    os.rename(path, tmp_path / "decisions.jsonl")
    assert read_decisions(tmp_path) == states[-1]


@pytest.mark.parametrize("cut", range(1, 60, 7))
def test_a_last_line_that_was_cut_off_costs_nothing_else(tmp_path, cut):
    path = tmp_path / "decisions.jsonl"
    log = DecisionLog(path)
    log.decide("a", "accept")
    log.decide("b", "reject")
    content = path.read_bytes()
    path.write_bytes(content[:-cut])
    again = DecisionLog(path)
    assert again.history.current == ({"a": "accept", "b": "reject"} if cut == 1 else {"a": "accept"})
    assert bool(again.note) == (cut > 1)
    again.decide("c", "accept")
    assert DecisionLog(path).history.current == again.history.current
    assert all(json.loads(line) for line in path.read_text().splitlines())


def test_a_damaged_line_in_the_middle_is_named_and_nothing_is_changed(tmp_path):
    path = tmp_path / "d.jsonl"
    content = '{"name": "a", "decision": "accept"}\n{"na\n{"name": "b", "decision": "accept"}\n'
    path.write_text(content)
    with pytest.raises(DecisionFileError, match="line 2"):
        DecisionLog(path)
    assert path.read_text() == content


def test_a_decision_that_cannot_be_written_is_not_made(tmp_path):
    log = DecisionLog(tmp_path / "gone" / "d.jsonl")
    with pytest.raises(DecisionFileError, match="cannot be written"):
        log.decide("a", "accept")
    assert not log.history.current


def test_a_full_disk_leaves_no_half_line(tmp_path, monkeypatch):
    log = DecisionLog(tmp_path / "d.jsonl")
    log.decide("a", "accept")
    before = (tmp_path / "d.jsonl").read_bytes()

    def full(_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(DecisionFileError, match="No space"):
        patch.setattr(os, "fsync", full)
        log.decide("b", "accept")
    assert (tmp_path / "d.jsonl").read_bytes() == before
    assert log.history.current == {"a": "accept"}


def curation(tmp_path, loaded: list[str]) -> Curation:
    def load(name: str) -> ScanDisplay:
        loaded.append(name)
        return ScanDisplay(
            np.zeros((1, 3)), np.zeros((1, 3), np.uint8), np.zeros((0, 3)), np.zeros((0, 3), np.int64), name
        )

    items = [
        CurationItem(f"n{number}", ("ok", "failed")[number % 2], "", f"s{number // 4}") for number in range(8)
    ]
    return Curation(items, DecisionLog(tmp_path / "d.jsonl"), load)


def test_filters_steps_and_undo(tmp_path):
    page = curation(tmp_path, [])
    assert page.show_only(status="failed", subject="s1") and page.visible == ["n5", "n7"]
    assert page.name == "n5"
    page.decide("reject")
    page.decide("accept")
    assert page.name == "n7"
    assert not page.show_only(status="failed", subject="s1", decision="undecided")
    assert page.visible == ["n5", "n7"]
    page.go("n0")
    assert len(page.visible) == 8
    assert page.undo() and page.name == "n7" and page.verdict() is None
    assert page.show_only(decision="rejected") and page.visible == ["n5"]
    page.close()
    with pytest.raises(ValueError, match="n9"):
        page.go("n9")


def test_it_starts_at_the_first_undecided_and_loads_one_ahead(tmp_path):
    first = curation(tmp_path, [])
    first.decide("accept")
    first.close()
    loaded: list[str] = []
    page = curation(tmp_path, loaded)
    assert page.name == "n1" and page.display().note == "n1"
    page.step(1)
    assert page.display().note == "n2"
    page.step(-1)
    page.display()
    page.close()
    assert loaded[:2] == ["n1", "n2"] and len(loaded) == len(set(loaded))
