"""``corporeal pipeline``: its rounds, what it keeps, what it redoes, and where it waits."""

import json
from functools import partial
from importlib import import_module

import numpy as np
import pytest

from corporeal.cli.main import main
from corporeal.learning.files import load_learned
from corporeal.learning.learned import LearnedModel, StepLog
from corporeal.learning.options import LearningOptions
from corporeal.model.files import load_model, open_model
from corporeal.registration.session.files import read_records
from corporeal.registration.session.model_digest import model_digest


@pytest.fixture(scope="module")
def records(made_records):
    return made_records(open_model("hand"), people=3, poses=2)


@pytest.fixture
def registered(records, write_registrations, monkeypatch):
    """What registering was asked to do; it leaves the same records whatever the model is."""
    calls = []

    def fake(call, model):
        calls.append((call, model))
        if call.restart:
            (call.output / "decisions.jsonl").unlink(missing_ok=True)
        write_registrations(call.output, records, model)
        items = [{"name": record.name, "status": record.row["status"]} for record in records]
        (call.output / "session.json").write_text(json.dumps({"items": items}))
        return 0

    monkeypatch.setattr(import_module("corporeal.cli.pipeline"), "run_session", fake)
    return calls


@pytest.fixture
def taught(monkeypatch):
    """Names of the registrations that each model was learned from; it tells them by the template's size."""
    calls = []

    def fake(training, start, options, on_step):
        calls.append(training.names)
        log = StepLog(1, "poses", len(training), 1.0, 1.0, 0.3, 0.0)
        on_step(log)
        hands = tuple(sorted(set(training.hands)))
        model = start.replace(template=start.template * (1 + 1e-3 * len(training)))
        return LearnedModel(
            model=model, hands=hands, subjects=tuple(hand[:3] for hand in hands),
            templates=np.stack([start.template] * len(hands)),
            joints=np.zeros((len(hands), start.joint_count, 3)),
            names=training.names, poses=training.poses, translations=training.translations,
            rms_mm=np.zeros(len(training)), log=(log,), shape_variances=np.ones(2), pose_variances=np.ones(3),
            left_out=(), options=options,
        )  # fmt: skip

    monkeypatch.setattr(import_module("corporeal.cli.learn"), "learn_model", fake)
    return calls


@pytest.fixture
def pipeline(tmp_path):
    """Run the command on a folder that nobody looks into; its exit status."""

    def run(*options):
        return main(["pipeline", str(tmp_path / "session"), "-o", str(tmp_path / "out"), *options])

    return run


def test_every_round_registers_with_the_model_of_the_one_before(registered, taught, pipeline, tmp_path):
    result, out = tmp_path / "result.json", tmp_path / "out"
    assert pipeline("--json", str(result), "--workers", "3", "--name", "mine") == 0
    (first, start), (second, learned) = registered
    assert (first.folder, first.workers, first.restart) == (tmp_path / "session", 3, False)
    assert first.output == out / "round-1" / "registrations" and first.landmarks_from is None
    assert second.output == out / "round-2" / "registrations" and second.landmarks_from == first.output
    assert model_digest(start) == model_digest(open_model("hand"))
    assert model_digest(learned) == model_digest(load_model(out / "round-1" / "model.npz"))
    for name in ("model.npz", "model.learning.npz"):
        assert (out / name).read_bytes() == (out / "round-2" / name).read_bytes()
    # Both rounds enlarge the template by 8 per mille: the second one learned from the first.
    ratio = load_model(out / "model.npz").template / start.template
    np.testing.assert_allclose(ratio[np.abs(start.template) > 1e-3], 1.008**2, rtol=1e-5)
    assert load_learned(out / "model.npz").model.name == "mine"
    rounds = json.loads(result.read_text())["rounds"]
    assert [(item["round"], item["statuses"], item["registrations"]) for item in rounds] == [
        (1, {"ok": 8}, 8), (2, {"ok": 8}, 8),
    ]  # fmt: skip


@pytest.mark.slow
def test_the_same_command_keeps_all_models(registered, taught, pipeline, tmp_path, capsys):
    result = tmp_path / "result.json"
    pipeline("--json", str(result))
    before = json.loads(result.read_text())
    capsys.readouterr()
    assert pipeline("--json", str(result)) == 0
    assert len(taught) == 2 and not any(call.restart for call, _ in registered)
    assert capsys.readouterr().err.count("it is kept") == 2
    assert json.loads(result.read_text()) == before
    # A third round goes on from what is there.
    assert pipeline("--rounds", "3") == 0
    assert len(taught) == 3


def test_a_rejected_scan_teaches_anew_and_all_that_follows_is_redone(
    registered, taught, pipeline, records, decide, tmp_path, capsys
):
    pipeline()
    decide(tmp_path / "out" / "round-1" / "registrations", {records[3].name: "reject"})
    capsys.readouterr()
    assert pipeline() == 0
    said = capsys.readouterr().err
    assert "this has changed: accepted registrations; it is learned anew" in said
    assert "round 2: was registered with another model" in said
    assert [call.restart for call, _ in registered] == [False, False, False, True]
    assert [len(names) for names in taught] == [8, 8, 7, 8] and records[3].name not in taught[2]
    assert len(read_records(tmp_path / "out" / "round-2" / "registrations")) == 8


@pytest.mark.parametrize(
    ("spoil", "options", "words"),
    [
        (lambda folder: (folder / "model.npz").unlink(), [], None),
        (lambda folder: (folder / "model.learning.npz").write_bytes(b""), [], "is not what was learned"),
        (lambda folder: (folder / "state.json").unlink(), [], "it is not known what"),
        (lambda folder: None, ["--seed", "5"], "options of learning"),
        (lambda folder: None, ["--name", "other"], "changed: name"),
    ],
)
def test_a_model_that_is_not_what_would_be_learned_is_learned_anew(
    registered, taught, pipeline, tmp_path, capsys, spoil, options, words
):
    pipeline("--rounds", "1")
    spoil(tmp_path / "out" / "round-1")
    capsys.readouterr()
    assert pipeline("--rounds", "1", *options) == 0
    assert len(taught) == 2
    assert words is None or words in capsys.readouterr().err
    assert load_learned(tmp_path / "out" / "model.npz").names == taught[1]


def test_it_waits_for_the_curator_after_every_registration(
    registered, taught, pipeline, records, decide, tmp_path, capsys
):
    rejected = {records[0].name: "reject"}
    for number in (1, 2):
        folder = tmp_path / "out" / f"round-{number}" / "registrations"
        assert pipeline("--wait-for-curation") == 0
        assert capsys.readouterr().out == f"corporeal curate {folder}\n"
        assert len(taught) == number - 1 and not (tmp_path / "out" / "model.npz").exists()
        decide(folder, rejected)
    assert pipeline("--wait-for-curation") == 0
    assert capsys.readouterr().out == ""
    assert [len(names) for names in taught] == [7, 7] and (tmp_path / "out" / "model.npz").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--rounds", "0"], "--rounds 0: at least one"),
        (["--workers", "0"], "--workers 0: at least one"),
        (["--subjects", "4"], "go with --simulate"),
        (["--start", "nowhere.npz"], "nowhere.npz"),
        ([], "session"),
    ],
)
def test_wrong_calls_exit_with_two_and_say_why(pipeline, tmp_path, capsys, options, words):
    assert pipeline(*options) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out" / "model.npz").exists()


@pytest.mark.slow
def test_from_nothing_to_a_model_in_two_rounds(pipeline, tmp_path, monkeypatch):
    quick = partial(LearningOptions, correctives=False, sweeps=1)
    monkeypatch.setattr(import_module("corporeal.cli.pipeline"), "LearningOptions", quick)
    result = tmp_path / "result.json"
    options = ["--simulate", "--subjects", "3", "--poses", "3", "--workers", "2", "--json", str(result)]
    assert pipeline(*options, "--pictures") == 0
    first, second = json.loads(result.read_text())["rounds"]
    assert first["subjects"] == second["subjects"] == 3
    assert second["registrations"] == second["statuses"]["ok"] > 8
    notes = [record.row["notes"] for record in read_records(tmp_path / "out" / "round-2" / "registrations")]
    assert sum("landmarks of an earlier registration" in note for note in notes) > 8
    assert {path.name for path in (tmp_path / "out").glob("model.*")} == {
        "model.npz", "model.learning.npz", "model.shape.png", "model.pose.png", "model.glb",
    }  # fmt: skip
