"""``corporeal curate``: look at the scans of a registered session, and accept or reject each."""

from __future__ import annotations

import webbrowser
from typing import Any

from rich.console import Console

from corporeal.cli.commands import Curate
from corporeal.cli.errors import CommandError
from corporeal.cli.session_pictures import SessionPictures, model_of
from corporeal.registration.session.files import DECISIONS, SessionFolderError, read_records
from corporeal.registration.session.records import RecordError
from corporeal.view.curation import Curation, CurationItem
from corporeal.view.files import DecisionFileError, DecisionLog


def run(config: Curate) -> int:
    """Serve the page until Ctrl-C."""
    try:
        from corporeal.view.contact_sheet import PictureDrawer
        from corporeal.view.guarded_server import PortError
        from corporeal.view.page import CurationPage
    except ImportError as error:
        raise CommandError(
            "curate: needs viser; install it with: pip install 'corporeal[view]'", 2
        ) from error
    try:
        items = [_item(record.row) for record in read_records(config.folder)]
        log = DecisionLog(config.folder / DECISIONS)
        pictures = SessionPictures(config.folder, config.session, model_of(config.folder))
    except (RecordError, DecisionFileError, SessionFolderError) as error:
        raise CommandError(str(error), 2) from error
    if not items:
        raise CommandError(f"{config.folder}: holds no records yet; nothing is there to curate")
    console = Console(stderr=True)
    if log.note:
        console.print(log.note, highlight=False)
    curation = Curation(items, log, pictures.display)
    drawer = PictureDrawer(curation.items, pictures.thumbnail)
    try:
        page = CurationPage(curation, drawer, config.port)
    except PortError as error:
        drawer.close()
        curation.close()
        raise CommandError(f"curate: {error}", 2) from error
    # On stdout and whole, so that programs can read it.
    print(page.url, flush=True)
    console.print("Ctrl-C ends the page; every decision is written already", highlight=False)
    if config.browser:
        webbrowser.open(page.url)
    try:
        page.wait()
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
    done = sum(name in log.history.current for name in curation.items)
    console.print(f"{done} of {len(items)} decided", highlight=False)
    return 0


def _item(row: dict[str, Any]) -> CurationItem:
    signals = [(key.replace("_", " "), f"{value:.3g}") for key, value in row.get("signals", {}).items()
               if isinstance(value, int | float)]  # fmt: skip
    if row.get("s2m_mm"):
        signals.insert(0, ("s2m mean", f"{row['s2m_mm']['mean']:.2f} mm"))
    for key in ("protocol_pose", "side"):
        if row.get(key):
            signals.append((key.replace("_", " "), str(row[key])))
    return CurationItem(
        name=str(row["name"]),
        status=str(row["status"]),
        reason=str(row.get("reason", "")),
        subject=str(row.get("subject") or ""),
        signals=tuple(signals),
    )
