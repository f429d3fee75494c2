import importlib.util
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from corporeal.cli.main import main

_PLACE = Path(__file__).with_name("made_session.py")
_SPEC = importlib.util.spec_from_file_location("made_session", _PLACE)
made_session = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(made_session)

COUNT = 12


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[Path, Path]:
    return made_session.make_session(tmp_path_factory.mktemp("made"), COUNT, np.random.default_rng(3))


@pytest.fixture(scope="module")
def report(made) -> tuple[str, dict]:
    session, results = made
    out, result = results / "out" / "r.html", results / "result.json"
    assert (
        main(["report", str(results), "-o", str(out), "--session", str(session), "--json", str(result)]) == 0
    )
    return out.read_text(), json.loads(result.read_text())


class Links(HTMLParser):
    def __init__(self):
        super().__init__()
        self.links, self.open = [], []

    def handle_starttag(self, tag, attributes):
        self.links += [value for key, value in attributes if key in ("src", "href", "action")]
        assert tag not in ("script", "link", "iframe")
        if tag not in ("meta", "br", "img", "rect", "line"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if tag in self.open:
            self.open.remove(tag)


def test_the_page_stands_alone(report):
    page, _ = report
    links = Links()
    links.feed(page)
    assert len(links.links) == 9 and all(link.startswith("data:image/png;base64,") for link in links.links)
    assert not links.open
    assert "url(" not in page and "@import" not in page
    assert "<&>" not in page


def test_counts_reasons_and_groups(report):
    summary = report[1]["summary"]
    assert summary["counts"] == {"doubtful": 3, "failed": 3, "ok": 6}
    assert [row["scans"] for row in summary["subjects"]] == [4, 4, 4]
    assert sum(row["scans"] for row in summary["poses"]) == COUNT
    assert summary["failure_reasons"] == [{"reason": "reason … <&>", "count": 3, "example": "s00_p03_right"}]
    registered = [n for n in range(COUNT) if n % 4 != 3]
    np.testing.assert_allclose(summary["s2m_mm"]["mean"], 0.2 + np.mean(registered) / 100)
    assert len(report[1]["items"]) == COUNT


def test_errors_are_those_that_were_made(report):
    """Moved by 0.5 + n / 10 mm, all of it normal or tangential; joints go along with the translation."""
    for name, errors in report[1]["truth_mm"].items():
        number = int(name[5:7])
        if number % 4 == 3:
            assert errors["v2v"] is None
            continue
        for kind in ("v2v", "v2v_max", "joints"):
            np.testing.assert_allclose(errors[kind], 0.5 + number / 10, atol=0.01)
        assert 0 < errors["normal"] < errors["v2v"] and 0 < errors["tangential"] < errors["v2v"]
    flags = report[1]["summary"]["flagging"]
    assert flags["scans"] == COUNT and flags["true_failures"] == flags["without_registration"] == 3
    assert flags["failures_marked_failed"] == 1 and flags["others_marked_failed"] == 0
    np.testing.assert_allclose(flags["others_marked_doubtful"], 3 / 9)
    groups = report[1]["summary"]["truth_mm"]
    assert {name: group["v2v"]["count"] for name, group in groups.items()} == {
        "all registered": 9, "not failed": 9, "ok": 6,
    }  # fmt: skip


def test_the_worst_come_first(report):
    names = re.findall(r"<figcaption><b>s\d\d_p(\d\d)", report[0])
    assert names == ["10", "09", "08", "06", "05", "04", "02", "01", "00"]


def test_a_session_without_truth(made, tmp_path, capsys):
    assert main(["report", str(made[1]), "-o", str(tmp_path / "r.html")]) == 0
    assert "has no truth" in (tmp_path / "r.html").read_text()
    assert "12 scans" in capsys.readouterr().err


def test_a_wrong_folder_and_a_damaged_record(made, tmp_path, capsys):
    assert main(["report", str(tmp_path)]) == 2
    assert "corporeal register" in capsys.readouterr().err
    (tmp_path / "records").mkdir()
    content = (made[1] / "records" / "s00_p00_right.npz").read_bytes()
    (tmp_path / "records" / "cut.npz").write_bytes(content[: len(content) // 2])
    assert main(["report", str(tmp_path)]) == 2
    assert "cut.npz" in capsys.readouterr().err
