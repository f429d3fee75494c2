"""The report on a registered session: one HTML file that asks for nothing else."""

from __future__ import annotations

import base64
import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from corporeal.atomic import write_bytes
from corporeal.export.report_plots import COLOURS, histogram_svg
from corporeal.export.report_summary import s2m

_STYLE = """
body{font:15px/1.45 system-ui,sans-serif;max-width:1080px;margin:32px auto;padding:0 16px;color:#26282c}
h1{font-size:24px}h2{font-size:18px;margin-top:32px}table{border-collapse:collapse}
th,td{padding:3px 12px;border-bottom:1px solid #e3e3e0;text-align:right;font-variant-numeric:tabular-nums}
th:first-child,td:first-child{text-align:left}svg text{font:11px system-ui;fill:#556}
.worst{display:grid;grid-template-columns:repeat(auto-fill,minmax(310px,1fr));gap:14px}
figure{margin:0;border:1px solid #e3e3e0;padding:6px}figure img{width:100%}figcaption{font-size:13px}
pre{background:#f4f4f2;padding:10px;overflow:auto;font-size:12px}.counts b{font-size:22px;margin-right:4px}
.counts span{margin-right:26px}
"""
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


@dataclass(frozen=True, eq=False)
class Report:
    """What the page tells.

    Attributes:
        title: of the page.
        items: the rows of the session.
        summary: of ``summarise``, with "flagging" where there is a truth.
        worst: (row, PNG or None, what is said below it).
        truth_mm: scan -> errors, or None.
        manifest: of the session.
    """

    title: str
    items: Sequence[Mapping[str, Any]]
    summary: Mapping[str, Any]
    worst: Sequence[tuple[Mapping[str, Any], bytes | None, str]]
    truth_mm: Mapping[str, Mapping[str, float | None]] | None
    manifest: Mapping[str, Any]


def write_report(path: Path | str, report: Report) -> None:
    """Write the page whole or not at all.

    Raises:
        OSError: it cannot be written.
    """
    write_bytes(path, report_html(report).encode())


def report_html(report: Report) -> str:
    """The page; every text in it is escaped, and its policy forbids it to load anything."""
    summary = report.summary
    parts = [
        "<!doctype html><html lang=en><head><meta charset=utf-8>",
        f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
        f"<title>{html.escape(report.title)}</title><style>{_STYLE}</style></head><body>",
        f"<h1>{html.escape(report.title)}</h1>",
        _counts(summary),
        "<h2>Distance of the scan to the registration (s2m), mean per scan</h2>",
        _histogram(report.items),
        _numbers_table({"s2m, mm": summary["s2m_mm"], "seconds per scan": summary["seconds"]}),
        _truth(report),
        "<h2>Worst registrations</h2>",
        "<p>Left the scan, coloured by its distance (blue 0, red 3 mm and more); right the registration.</p>",
        f"<div class=worst>{''.join(_figure(*entry) for entry in report.worst)}</div>",
    ]
    for heading, key in (("Failures", "failure_reasons"), ("Doubts", "doubt_reasons")):
        parts += [f"<h2>{heading}, by reason</h2>", _table(summary[key])]
    for heading, key in (("poses", "poses"), ("subjects", "subjects"), ("sides", "sides")):
        parts += [f"<h2>By {heading}</h2>", _table(summary[key])]
    manifest = {key: value for key, value in report.manifest.items() if key != "scans"}
    parts += [
        "<h2>Made with</h2>",
        f"<pre>{html.escape(json.dumps(manifest, indent=2, sort_keys=True))}</pre></body></html>\n",
    ]
    return "".join(parts)


def _counts(summary: Mapping[str, Any]) -> str:
    spans = "".join(
        f"<span style='color:{COLOURS.get(status, '#26282c')}'><b>{count}</b>{html.escape(status)}</span>"
        for status, count in summary["counts"].items()
    )
    return f"<p class=counts><span><b>{summary['scans']}</b>scans</span>{spans}</p>"


def _histogram(items: Sequence[Mapping[str, Any]]) -> str:
    return histogram_svg(
        {
            status: [value for item in items if item["status"] == status and (value := s2m(item)) is not None]
            for status in COLOURS
        },
        "mm",
    )


def _truth(report: Report) -> str:
    if report.truth_mm is None:
        return "<h2>Against the truth</h2><p>This session has no truth beside its scans.</p>"
    values = [errors["v2v"] for errors in report.truth_mm.values() if errors["v2v"] is not None]
    parts = ["<h2>Against the truth</h2>", histogram_svg({"v2v": values}, "v2v, mean per scan, mm")]
    for which, errors in report.summary["truth_mm"].items():
        parts += [
            f"<h3>{html.escape(which)}</h3>",
            _numbers_table({f"{kind}, mm": row for kind, row in errors.items()}),
        ]
    parts += [
        "<p>v2v: mean distance of the template's vertices from their true positions; normal and tangential: "
        "its parts off and within the true surface; "
        "joints: of the fitted model from the simulator's bones.</p>",
        "<h3>Are true failures flagged?</h3>",
        _table(
            [
                {"name": name.replace("_", " "), "value": value}
                for name, value in report.summary["flagging"].items()
            ]
        ),
        "<p>A true failure has a mean v2v above 4 mm, or no registration.</p>",
    ]
    return "".join(parts)


def _figure(row: Mapping[str, Any], png: bytes | None, words: str) -> str:
    picture = "<p>no picture</p>"
    if png is not None:
        picture = f"<img alt='' src='data:image/png;base64,{base64.b64encode(png).decode()}'>"
    name, reason = html.escape(str(row["name"])), html.escape(str(row["reason"]))
    caption = f"<b>{name}</b>, {html.escape(str(row['status']))}<br>{html.escape(words)}<br>{reason}"
    return f"<figure>{picture}<figcaption>{caption}</figcaption></figure>"


def _numbers_table(rows: Mapping[str, Mapping[str, Any] | None]) -> str:
    return _table([{"": name, **row} for name, row in rows.items() if row is not None])


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    if not rows:
        return "<p>none</p>"
    keys = [key for key in rows[0] if any(row.get(key) is not None for row in rows)]
    head = "".join(f"<th>{html.escape(key.replace('_', ' '))}</th>" for key in keys)
    body = "".join(f"<tr>{''.join(_cell(row.get(key)) for key in keys)}</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def _cell(value: Any) -> str:
    if value is None:
        return "<td>–</td>"
    return f"<td>{value:.3f}</td>" if isinstance(value, float) else f"<td>{html.escape(str(value))}</td>"
