"""What the player's panel says, as HTML: the frame in words, the strip of all frames, those to look at."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from dataclasses import dataclass

from corporeal.view.track import FrameRow, problem_stretches

STATUS_COLOURS = {"ok": "#3a9a5b", "doubtful": "#d98e2b", "failed": "#c2413b"}
_UNKNOWN = "#8a8f98"
_MOST_BINS, _MOST_STRETCHES = 300, 8
_LEAST_TOP_MM = 5.0
_HEIGHT = 40
_SENT = "fetch('/do?action=go&frame='+{frame})"
_KEYS = {
    " ": "toggle", "ArrowRight": "next", "ArrowLeft": "previous", "Home": "first", "End": "last",
    "n": "next_problem", "p": "previous_problem",
}  # fmt: skip
# viser turns the camera by the arrows, and a button that has the focus is pressed by space: the page takes
# these keys before both. Where one types, or a list is open, they are left alone.
_SCRIPT = """
if(!window.corporealKeys){window.corporealKeys=%s;
const typing=t=>t.matches&&t.matches('textarea,[contenteditable=true],input:not([type=checkbox])')&&
 t.getAttribute('aria-expanded')!=='false'&&!t.readOnly;
const taken=e=>window.corporealKeys[e.key]&&!e.ctrlKey&&!e.altKey&&!e.metaKey&&!typing(e.target);
window.addEventListener('keydown',e=>{if(!taken(e))return;e.preventDefault();e.stopPropagation();
 const action=window.corporealKeys[e.key];if(action==='toggle'&&e.repeat)return;
 fetch('/do?action='+action)},true);
window.addEventListener('keyup',e=>{if(taken(e)){e.preventDefault();e.stopPropagation()}},true)}
"""


@dataclass(frozen=True)
class PlayerWords:
    """What is said of a moment.

    Attributes:
        sequence: its name.
        index: of the frame.
        count: of frames.
        seconds: of the frame since the first.
        row: what is known of the frame.
        playing: whether it plays.
        scan: what is shown of the scan, for instance "of 0012" or "is being read".
        scan_index: whose scan is shown, or None.
        message: what else the user should know, or "".
    """

    sequence: str
    index: int
    count: int
    seconds: float
    row: FrameRow
    playing: bool
    scan: str
    scan_index: int | None
    message: str = ""


def keys_html() -> str:
    """An element without a face that takes the keys of the player."""
    script = html.escape(_SCRIPT % json.dumps(_KEYS), quote=True)
    return f'<img alt="" src="data:," style="display:none" onerror="{script}">'


def words_html(words: PlayerWords) -> str:
    """The frame in words; its numbers are in ``data-`` attributes as well, for programs."""
    row = words.row
    colour = STATUS_COLOURS.get(row.status, _UNKNOWN)
    known = "-" if row.s2m_mm is None else f"{row.s2m_mm:.2f} mm"
    lines = [("scan to model", known, None)]
    lines += [(f"{what} seen", f"{100 * share:.0f} %", share) for what, share in row.seen]
    lines.append(("scan", words.scan, None))
    table = "".join(
        f"<tr><td style='color:#667;padding-right:1em'>{html.escape(what)}</td>"
        f"<td style='text-align:right'>{html.escape(value)}</td><td style='width:6em'>{_bar(share)}</td></tr>"
        for what, value, share in lines
    )
    scan = "" if words.scan_index is None else str(words.scan_index)
    return (
        f"<div id='player' data-frame='{words.index}' data-count='{words.count}' data-scan='{scan}' "
        f"data-playing='{int(words.playing)}' data-status='{html.escape(row.status, quote=True)}' "
        "style='margin:0 1em;font-size:0.9em;line-height:1.45'>"
        f"<span style='float:right;background:{colour};color:#fff;border-radius:9px;padding:0 0.7em'>"
        f"{html.escape(row.status)}</span>"
        f"<b style='font-size:1.1em'>{html.escape(words.sequence)}</b><br>"
        f"frame <b>{html.escape(row.name)}</b>, {words.index + 1} of {words.count}, {words.seconds:.2f} s<br>"
        f"<span style='color:{colour}'>{html.escape(row.reason)}</span>"
        f"<table style='border-collapse:collapse'>{table}</table>"
        f"<span style='color:#b3261e'>{html.escape(words.message)}</span></div>"
    )


def strip_html(rows: Sequence[FrameRow], index: int) -> str:
    """All frames in one strip: status as colour, scan to model as height, where it stands as a line.

    A click goes to the frame below it.
    """
    count = len(rows)
    bins = _binned(rows)
    means = [mean for _, mean in bins if mean is not None]
    top = max(_LEAST_TOP_MM, *means) if means else _LEAST_TOP_MM
    width = count / len(bins)
    shapes = []
    for number, (status, mean) in enumerate(bins):
        height = _HEIGHT if mean is None else max(2.0, _HEIGHT * mean / top)
        shapes.append(
            f"<rect x='{number * width:.2f}' y='{_HEIGHT - height:.1f}' width='{width:.2f}' "
            f"height='{height:.1f}' fill='{STATUS_COLOURS.get(status, _UNKNOWN)}'/>"
        )
    frame = f"Math.floor((event.clientX-this.getBoundingClientRect().left)/this.clientWidth*{count})"
    click = html.escape(_SENT.format(frame=frame), quote=True)
    place = 100 * (index + 0.5) / count
    return (
        f'<div style="margin:0.4em 1em;position:relative;cursor:pointer" onclick="{click}" '
        f'title="scan to model, up to {top:.0f} mm; click to go there">'
        f"<svg style='display:block;width:100%;height:{_HEIGHT}px;background:#eef0f2;border-radius:3px' "
        f"viewBox='0 0 {count} {_HEIGHT}' preserveAspectRatio='none' "
        f"shape-rendering='crispEdges'>{''.join(shapes)}</svg>"
        f"<div style='position:absolute;top:-3px;bottom:-3px;width:2px;background:#26282c;"
        f"left:calc({place:.2f}% - 1px)'></div></div>"
    )


def problems_html(rows: Sequence[FrameRow]) -> str:
    """Stretches of frames that are not ok, each a link to its first frame."""
    stretches = problem_stretches(rows)
    if not stretches:
        return (
            "<div id='problems' style='margin:0.3em 1em;font-size:0.85em;color:#667'>all frames are ok</div>"
        )
    counts = ", ".join(
        f"{number} {status}"
        for status in STATUS_COLOURS
        if status != "ok" and (number := sum(row.status == status for row in rows))
    )
    lines = [f"<span style='color:#667'>{counts}; n and p go to the next and the previous</span>"]
    for first, last in stretches[:_MOST_STRETCHES]:
        row = rows[first]
        name = row.name if first == last else f"{row.name} to {rows[last].name}"
        click = html.escape(_SENT.format(frame=first) + ";return false", quote=True)
        reason = f": {row.reason}" if row.reason else ""
        lines.append(
            f'<a href="#" data-go="{first}" onclick="{click}" style="text-decoration:none;color:'
            f'{STATUS_COLOURS.get(row.status, _UNKNOWN)}">'
            f"<b>{html.escape(name)}</b> {html.escape(row.status + reason)}</a>"
        )
    if len(stretches) > _MOST_STRETCHES:
        lines.append(f"<span style='color:#667'>and {len(stretches) - _MOST_STRETCHES} more</span>")
    content = "<br>".join(lines)
    return f"<div id='problems' style='margin:0.3em 1em;font-size:0.85em;line-height:1.4'>{content}</div>"


def legend_html(worst_mm: float) -> str:
    """What the colours of the scan mean."""
    return (
        "<div style='margin:0.3em 1em;font-size:0.85em'>scan to model "
        "<span style='background:linear-gradient(90deg,#264085,#3385b8,#99d1ad,#fae68c,#f08540,#a60d1f);"
        "color:#fff;padding:1px 6px;border-radius:3px'>"
        f"0 &nbsp; &nbsp; {worst_mm / 2:g} &nbsp; &nbsp; {worst_mm:g} mm</span></div>"
    )


def _bar(share: float | None) -> str:
    if share is None:
        return ""
    width = 100 * min(max(share, 0.0), 1.0)
    return (
        "<div style='margin-left:0.6em;height:0.5em;background:#e4e6e9;border-radius:3px'>"
        f"<div style='width:{width:.0f}%;height:100%;background:#5b86b8;border-radius:3px'></div></div>"
    )


def _binned(rows: Sequence[FrameRow]) -> list[tuple[str, float | None]]:
    """At most so many (status, mean): the worst status of a bin's frames, and the greatest mean."""
    count = min(len(rows), _MOST_BINS)
    order = ("failed", "doubtful", "ok")
    bins = []
    for number in range(count):
        part = rows[number * len(rows) // count : (number + 1) * len(rows) // count]
        statuses = {row.status for row in part}
        worst = next((status for status in order if status in statuses), part[0].status)
        means = [row.s2m_mm for row in part if row.s2m_mm is not None]
        bins.append((worst, max(means) if means else None))
    return bins
