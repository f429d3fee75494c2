"""``corporeal evaluate``: what it reads, keeps and writes, and what it refuses."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from corporeal.cli import evaluate, variant_models
from corporeal.cli.commands import Evaluate
from corporeal.cli.main import main
from corporeal.cli.registered_session import read_registered, true_scans
from corporeal.cli.variant_models import learned_variants
from corporeal.export.meshes import write_ply
from corporeal.learning.evaluation import study
from corporeal.learning.evaluation.variants import (
    CONSTANT,
    MIRRORED,
    ONE_SIDED,
    WITHOUT_CORRECTIVES,
    WITHOUT_NEUTRAL_FIRST,
    Variant,
)
from corporeal.learning.files import companion_path, save_learned
from corporeal.learning.learned import LearnedModel
from corporeal.learning.options import LearningOptions
from corporeal.learning.training_set import training_set
from corporeal.model.files import open_model

PEOPLE = ("t01", "t02", "t03")


@pytest.fixture(scope="module")
def learned():
    """The open hand with the records of a learning that never was."""
    hand, rng = open_model("hand"), np.random.default_rng(8)
    shapes = rng.standard_normal((3, hand.shape_count))
    templates = hand.template + np.einsum("vas,hs->hva", hand.shape_directions, shapes)
    return LearnedModel(
        model=hand.replace(pose_directions=1e-3 * rng.standard_normal((hand.vertex_count, 3, 135))),
        hands=tuple(f"{person}/right" for person in PEOPLE), subjects=PEOPLE, templates=templates,
        joints=np.stack([hand.joint_regressor @ template for template in templates]),
        names=tuple(f"{person}_p01_right" for person in PEOPLE), poses=0.3 * rng.standard_normal((3, 16, 3)),
        translations=np.zeros((3, 3)), rms_mm=np.ones(3), log=(), shape_variances=np.array([2.0, 1.0]),
        pose_variances=np.array([3.0, 1.0]), left_out=(),
        options=LearningOptions(corrective_strength=0.8, start_shape_weight=1.0),
    )  # fmt: skip


@pytest.fixture(scope="module")
def model_file(learned, tmp_path_factory):
    path = tmp_path_factory.mktemp("model") / "mine.npz"
    save_learned(learned, path)
    return path


@pytest.fixture(scope="module")
def held_out_folder(made_records, write_registrations, tmp_path_factory):
    """Two people with three right registrations each, the first of them natural; scans without truth."""
    folder, hand = tmp_path_factory.mktemp("held_out"), open_model("hand")
    records = []
    for record in made_records(hand, people=2, poses=3, seed=9):
        row = dict(record.row)
        if row["protocol_pose"] == "p00":
            row["protocol_pose"] = "natural"
        row |= {"scan": str(folder / "scans" / f"{record.name}.ply"), "unit": "mm"}
        write_ply(folder / "scans" / f"{record.name}.ply", 1e3 * record.vertices, hand.faces)
        records.append(dataclasses.replace(record, row=row))
    return write_registrations(folder / "reg", records)


def _evaluate(model, folder, output, *options):
    return main(["evaluate", str(model), "--test", str(folder), "-o", str(output), *options])


@pytest.mark.slow
def test_tables_plots_and_key_figures_are_written(model_file, held_out_folder, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(study, "_POSE_COMPONENTS", (6,))
    monkeypatch.setattr(study, "_FEW_COMPONENTS", ())
    output, result = tmp_path / "e", tmp_path / "e.json"
    assert _evaluate(model_file, held_out_folder, output, "--workers", "1", "--json", str(result)) == 0
    content = json.loads(result.read_text())
    assert {key: content[key] for key in content if key != "seconds"} == json.loads(
        (output / "evaluation.json").read_text()
    )
    curves = {(curve["label"], curve["protocol"]): curve for curve in content["pose_generalisation"]}
    assert set(curves) == {
        ("learned", "pose only"), ("learned, correctives off", "pose only"),
        ("learned", "pose and shape free"),
    }  # fmt: skip
    assert {scan["name"] for scan in curves["learned", "pose only"]["scans"]} == {
        "s00_p00_right",
        "s01_p00_right",
    }
    assert content["truth"] == [] and any("no truth" in note for note in content["notes"])
    assert any("--train" in note for note in content["notes"])
    assert "# mine on reg" in (output / "evaluation.md").read_text()
    for ending in ("png", "svg"):
        assert (output / f"pose_generalisation.{ending}").stat().st_size > 1000
    printed = capsys.readouterr().out
    assert "correctives on / off, pose only: " in printed and "limit 0.72" in printed


def test_people_that_were_learned_from_are_refused(learned, held_out_folder, tmp_path, capsys):
    path = tmp_path / "mine.npz"
    save_learned(dataclasses.replace(learned, subjects=("s00", "t02", "t03")), path)
    assert _evaluate(path, held_out_folder, tmp_path / "e", "--train", str(held_out_folder)) == 2
    assert "learned from (s00 of" in capsys.readouterr().err
    assert not (tmp_path / "e").exists()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--scored", "fist"), "'fist'"),
        (("--workers", "0"), "--workers"),
        (("--start", "no-such-model"), "--start no-such-model"),
        (("--asset", "no-such-model"), "--asset no-such-model"),
        (("--asset", "body"), "another template or tree"),
    ],
)
def test_wrong_calls_are_refused(model_file, held_out_folder, tmp_path, capsys, options, said):
    assert _evaluate(model_file, held_out_folder, tmp_path / "e", *options) == 2
    assert said in capsys.readouterr().err


def test_training_registrations_must_be_those_of_the_model(model_file, held_out_folder, tmp_path, capsys):
    assert _evaluate(model_file, held_out_folder, tmp_path / "e", "--train", str(held_out_folder)) == 2
    assert (
        "was learned from 3 scans that are not there, for instance t01_p01_right" in capsys.readouterr().err
    )


def test_a_start_that_the_training_was_not_registered_with_is_refused(
    model_file, held_out_folder, tmp_path, capsys
):
    options = ("--train", str(held_out_folder), "--start", str(model_file), "--no-variants")
    assert _evaluate(model_file, held_out_folder, tmp_path / "e", *options) == 2
    assert "was registered with another model" in capsys.readouterr().err


def test_a_missing_model_companion_scan_or_folder_is_named(
    model_file, learned, held_out_folder, tmp_path, capsys
):
    assert _evaluate(tmp_path / "none.npz", held_out_folder, tmp_path / "e") == 2
    assert "none.npz" in capsys.readouterr().err
    alone = tmp_path / "alone.npz"
    save_learned(learned, alone)
    companion_path(alone).unlink()
    assert _evaluate(alone, held_out_folder, tmp_path / "e") == 2
    assert "alone.learning.npz: missing" in capsys.readouterr().err
    assert _evaluate(model_file, tmp_path, tmp_path / "e") == 2
    assert "holds no records" in capsys.readouterr().err


def test_variants_are_kept_and_learned_again_for_other_data(learned, made_records, tmp_path, monkeypatch):
    """The digest of data, options and start decides, and a damaged file is learned again."""
    hand, asked = open_model("hand"), []

    def learn(training, start, options, console):
        asked.append(len(training))
        return learned

    monkeypatch.setattr(variant_models, "learned_from", learn)
    training = training_set(made_records(hand, people=2, poses=2), hand)
    variant, console = Variant("right only, 20", training, LearningOptions()), Console(quiet=True)
    for _ in range(2):
        (found,) = learned_variants([variant], hand, tmp_path, console)
        assert found.variant is variant and len(found.learned.names) == 3
    assert asked == [6]
    assert {path.name for path in tmp_path.iterdir()} == {"right-only-20.npz", "right-only-20.learning.npz"}
    learned_variants(
        [dataclasses.replace(variant, training=training.subset(np.arange(4)))], hand, tmp_path, console
    )
    other = dataclasses.replace(variant, options=LearningOptions(correctives=False))
    learned_variants([other], hand, tmp_path, console)
    (tmp_path / "right-only-20.learning.npz").write_bytes(b"damaged")
    learned_variants([other], hand, tmp_path, console)
    assert asked == [6, 4, 6, 6]


def test_variants_are_learned_as_the_model_was_but_for_what_they_are_about(
    learned, made_records, write_registrations, held_out_folder, tmp_path, monkeypatch
):
    start, planned = open_model("hand"), []
    monkeypatch.setattr(evaluate, "learned_variants", lambda variants, *_: planned.extend(variants) or [])
    train = write_registrations(tmp_path / "train", made_records(start, people=3, poses=2), start)
    config = Evaluate(Path("mine.npz"), test=held_out_folder, output=tmp_path / "e", train=(train,))
    evaluate._variants(config, dataclasses.replace(learned, names=()), start, Console(quiet=True))
    assert {variant.label for variant in planned} >= {WITHOUT_CORRECTIVES, CONSTANT, ONE_SIDED, MIRRORED}
    changed = {WITHOUT_CORRECTIVES: {"correctives": False}, CONSTANT: {"regularisation": "constant"}}
    changed[WITHOUT_NEUTRAL_FIRST] = {"neutral_first": False}
    for variant in planned:
        assert variant.options == dataclasses.replace(learned.options, **changed.get(variant.label, {}))


def test_truth_is_read_where_the_session_was_simulated(learned, held_out_folder, tmp_path, capsys):
    """Its names and people are those of the plan; a truth that is damaged is named."""
    test = read_registered(held_out_folder, learned.model)
    assert test.simulation is None and true_scans(test, ["s01/right"]) == []
    (tmp_path / "truth").mkdir()
    (tmp_path / "session.json").write_text(json.dumps({"options": {"subjects": 2, "seed": 3, "unknown": 1}}))
    manifest = json.loads((held_out_folder / "manifest.json").read_text())
    before = json.dumps(manifest)
    try:
        (held_out_folder / "manifest.json").write_text(
            json.dumps(manifest | {"session": {"path": str(tmp_path)}})
        )
        test = read_registered(held_out_folder, learned.model)
    finally:
        (held_out_folder / "manifest.json").write_text(before)
    assert (test.simulation.subjects, test.simulation.seed, test.simulation.natural_share) == (2, 3, 0.15)
    assert true_scans(test, ["s01/right"]) == []
