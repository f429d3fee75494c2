import re
import runpy
from pathlib import Path

import pytest

from corporeal.export.evaluation_tables import evaluation_markdown

PLOTS = runpy.run_path(str(Path(__file__).parent / "test_evaluation_plots.py"))


@pytest.fixture
def results():
    return PLOTS["results"].__wrapped__()


def tables(words):
    """Heading -> tables below it; each a list of rows, each a mapping from column to cell."""
    found = {}
    for part in words.split("\n## ")[1:]:
        heading, rest = part.split("\n", 1)
        found[heading] = []
        for block in re.findall(r"(?:^\|.*\|$\n?)+", rest, flags=re.M):
            lines = [
                [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
                for line in block.strip().split("\n")
            ]
            assert len({len(line) for line in lines}) == 1
            assert len(lines) > 2, "an empty table"
            found[heading].append([dict(zip(lines[0], line, strict=True)) for line in lines[2:]])
    return found


def test_the_whole_document(results):
    words = evaluation_markdown(results, title="Six subjects")
    assert words.startswith("# Six subjects\n\n- 50 scans of 6 subjects.\n\n")
    found = tables(words)
    ((mirrored, crude, asset, constant),) = found["Ratios of mean scan-to-mesh errors"]
    assert mirrored == {
        "ratio": "mirrored / right only", "protocol": "pose only", "value": "0.600", "95 %": "0.500 to 0.700",
        "paper": "0.720", "limit": "≤ 1", "verdict": "met", "subjects": "6",
    }  # fmt: skip
    assert [row["verdict"] for row in (crude, asset, constant)] == ["not met", "met", "no limit"]
    full, by_components = found["Generalisation of the pose space: scan to mesh"]
    papers = [(row["model"], row["protocol"], row["paper"], row["verdict"]) for row in full]
    assert papers == [
        ("learned", "pose only", "0.93", "no limit"),
        ("right only", "pose only", "1.05", "no limit"),
        ("learned", "pose and shape free", "1.01", "no limit"),
        ("crude start", "pose and shape free", "2.90", "no limit"),
        ("asset start", "pose and shape free", "–", "no limit"),
    ]
    assert [row["pose components"] for row in by_components] == ["1", "6", "45"]
    assert by_components[1]["learned (pose only)"] == "0.333 ± 0.100"
    ((none, unknown),) = found["Generalisation of the shape space: vertices"]
    column = "learned (leave one subject out)"
    assert (none[column], unknown[column]) == ("3.000 ± 1.000", "–")
    (compactness,) = found["Compactness: share of the training set's variance"]
    assert [(row["share"], row["paper"]) for row in compactness] == [
        ("40.0 %", "–"), ("60.0 %", "–"), ("80.0 %", "81.0 %"), ("50.0 %", "–"),
    ]  # fmt: skip
    ((truth,),) = found["Against the truth of the simulation"]
    assert truth["verdict"] == "met"
    assert truth["limit"] == "≥ 0.6"
    assert "joint centres" not in truth
    ((local,),) = found["Locality of the pose correctives"]
    assert local["model"] == r"geodesic\|plain"
    assert local["share of corrective energy"] == "2.0 %"
    (points,) = found["Learning curve: scan to mesh in the full pose space"]
    assert [row["95 %"] for row in points] == ["–", "0.500 to 0.700"] * 2
    assert "Not measured" not in found


def test_every_table_names_its_protocol_and_limits(results):
    for heading, content in tables(evaluation_markdown(results)).items():
        named = heading.startswith("Against the truth") or any(
            any("protocol" in column or "(" in column for column in rows[0]) for rows in content
        )
        assert named, heading
        if not heading.startswith("Generalisation of the shape"):
            assert {"limit", "verdict"} & set(content[0][0]), heading


def test_a_curve_may_carry_its_own_limit_and_paper_figure(results):
    curve = results["pose_generalisation"][0]
    for limit, verdict in ((0.6, "met"), (0.58, "met"), (0.5, "not met")):
        curve.update(limit=limit, paper=0.4)
        row = tables(evaluation_markdown(results))["Generalisation of the pose space: scan to mesh"][0][0]
        assert (row["limit"], row["paper"], row["verdict"]) == (f"≤ {limit:g}", "0.40", verdict)
    curve["full"] = {"mean": None}
    row = tables(evaluation_markdown(results))["Generalisation of the pose space: scan to mesh"][0][0]
    assert (row["full pose space"], row["verdict"]) == ("–", "not met")
