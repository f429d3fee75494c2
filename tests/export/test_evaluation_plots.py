import json
import xml.etree.ElementTree as ET
from collections import Counter

import pytest
from PIL import Image

from corporeal.export.evaluation_plots import evaluation_plots, write_evaluation_plots
from corporeal.export.evaluation_tables import evaluation_markdown, write_evaluation_markdown

FULL = {"mean": 0.58, "median": 0.5, "p95": 1.0, "sd": 0.1}


def curve(label, protocol, components=(1, 6, 45)):
    values = [2.0 / count for count in components]
    return {
        "label": label, "protocol": protocol, "components": list(components), "mean": values,
        "sd": [0.1] * len(values), "n_scans": 50, "n_subjects": 6, "full": FULL, "scans": [],
    }  # fmt: skip


def ratio(name, numerator, denominator, protocol, limit=None, value=0.6):
    return {
        "name": name, "numerator": numerator, "denominator": denominator, "protocol": protocol,
        "value": value, "interval": [0.5, 0.7], "n_subjects": 6, "paper": 0.72, "limit": limit,
        "met": None if limit is None else value <= limit,
    }  # fmt: skip


@pytest.fixture
def results():
    return {
        "format": "corporeal-evaluation-1",
        "compactness": [
            {
                "label": "learned", "space": "pose", "components": [1, 2, 6], "shares": [0.4, 0.6, 0.8],
                "paper": {"components": [6, 10], "shares": [0.81, 0.9]},
            },
            {"label": "learned", "space": "shape", "components": [1], "shares": [0.5], "paper": None},
        ],
        "pose_generalisation": [
            curve("learned", "pose only"),
            curve("right only", "pose only"),
            curve("learned", "pose and shape free"),
            curve("crude start", "pose and shape free", ()),
            curve("asset start", "pose and shape free"),
        ],
        "shape_generalisation": [
            {"label": "learned", "protocol": "leave one subject out", "components": [0, 1],
             "mean": [3.0, None], "sd": [1.0, None], "n_subjects": 31, "n_hands": 62, "hands": []},
        ],
        "ratios": [
            ratio("mirrored / right only", "learned", "right only", "pose only", 1.0),
            ratio("learned / crude start", "learned", "crude start", "pose and shape free", 0.35),
            ratio("learned / asset start", "learned", "asset start", "pose and shape free", 0.8),
            ratio("geodesic / constant", "learned", "constant", "pose only"),
        ],
        "locality": [{"label": "geodesic|plain", "weighting": "plain", "distance_mm": 40.0, "share": 0.02}],
        "truth": [
            {"label": "learned", "r_squared": 0.7, "aligned": False, "error": FULL, "error_without": FULL,
             "joint_error": None, "n_scans": 20, "limit": 0.6, "met": True},
        ],
        "learning_curve": [
            {"label": label, "protocol": "pose only", "n_registrations": count, "mean": 0.6,
             "interval": [0.5, 0.7] if count > 100 else None, "n_subjects": 6}
            for label in ("mirrored", "right only") for count in (100, 777)
        ],
        "notes": ["50 scans of 6 subjects."],
    }  # fmt: skip


def drawn_lines(svg):
    """The number of lines of each kind that have an id, and the lines by id."""
    groups = [g for g in ET.parse(svg).iter("{http://www.w3.org/2000/svg}g") if ":" in g.get("id", "")]
    return Counter(g.get("id").split(":")[0] for g in groups), {g.get("id"): g for g in groups}


def test_every_figure_is_drawn_with_its_lines_and_names_its_protocol(results, tmp_path):
    drawn = write_evaluation_plots(tmp_path, results)
    expected = {
        "compactness": {"pose": 1, "mean": 2},
        "pose_generalisation": {"mean": 2, "sd": 2, "full": 2},
        "shape_generalisation": {"mean": 1, "sd": 1},
        "learning_curve": {"mean": 2},
        "mirrored_right_only": {"mean": 2, "sd": 2},
        "learned_against_starts": {"mean": 3, "sd": 3},
    }
    assert {plot.name for plot in drawn.plots} == set(expected)
    for name, kinds in expected.items():
        counts, lines = drawn_lines(tmp_path / f"{name}.svg")
        assert counts == kinds, name
        with Image.open(tmp_path / f"{name}.png") as picture:
            panels = 2 if name in ("compactness", "pose_generalisation") else 1
            assert picture.size == (735 * panels, 555)
    markers = lines["mean:learned:pose and shape free"].iter("{http://www.w3.org/2000/svg}use")
    assert len(list(markers)) == 3
    assert drawn.left_out == ("geodesic / constant: the evaluation holds no curves of both models",)
    for name, protocol in (
        ("pose_generalisation", "pose and shape free"), ("mirrored_right_only", "pose only"),
        ("shape_generalisation", "leave one subject out"), ("learning_curve", "pose only"),
    ):  # fmt: skip
        assert protocol in "".join(ET.parse(tmp_path / f"{name}.svg").getroot().itertext())


def test_equal_results_give_equal_bytes(results, tmp_path):
    for folder in ("a", "b"):
        write_evaluation_plots(tmp_path / folder, results)
        write_evaluation_markdown(tmp_path / folder / "evaluation.md", json.loads(json.dumps(results)))
    files = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert len(files) == 13
    for name in files:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_missing_sections_are_named_and_not_drawn():
    drawn = evaluation_plots({"notes": []})
    assert drawn.plots == ()
    assert [words.split(":")[0] for words in drawn.left_out] == [
        "compactness", "pose_generalisation", "shape_generalisation", "learning_curve",
    ]  # fmt: skip
    words = evaluation_markdown({})
    assert "|" not in words
    assert "holds nothing on: ratios, pose generalisation, shape generalisation, compactness, truth" in words


def test_faults_of_the_results_are_named(results):
    with pytest.raises(ValueError, match="format 'other', expected 'corporeal-evaluation-1'"):
        evaluation_plots({**results, "format": "other"})
    del results["pose_generalisation"][1]["full"]
    for read in (evaluation_plots, evaluation_markdown):
        with pytest.raises(ValueError, match=r"pose_generalisation\[1\] lacks full"):
            read(results)
    results["pose_generalisation"] = []
    results["shape_generalisation"][0]["sd"] = [1.0]
    with pytest.raises(ValueError, match=r"shape_generalisation\[0\]\.sd has 1 values for 2 components"):
        evaluation_plots(results)
