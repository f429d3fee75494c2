"""Which tracks a folder holds, and what to say where it holds none."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from corporeal.cli.errors import CommandError
from corporeal.cli.tracking_folder import REPORT
from corporeal.cli.viewed_track import ViewedTrack
from corporeal.fitting.files import FRAMES, TEMPLATE_STORY, TrackFileError
from corporeal.registration.session.files import (
    ITEMS,
    MANIFEST,
    SessionFolderError,
    has_records,
    read_json_file,
)
from corporeal.scans.formats.sequence import LIST


def find_tracks(folder: Path, scans: Path | None, known: Collection[str] = ()) -> list[ViewedTrack]:
    """The sequences of a folder that ``corporeal track`` wrote to, or the one whose folder it is.

    All have been read; some may have no frame, and a note.

    Args:
        folder: that the command names.
        scans: where the scans lie, if not where the results say.
        known: names of sequences that were found before; they are left out.

    Raises:
        CommandError: the folder holds no track, or none with a frame, and none was known before.
    """
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "does not exist"
        raise CommandError(f"view: {folder} {what}; give the folder that corporeal track wrote to", 2)
    if scans is not None and not scans.is_dir():
        raise CommandError(
            f"--scans {scans}: is no folder; give the one of the sequence, or that above it", 2
        )
    try:
        # Its name is the sequence's, which "." has none of.
        places = [folder.resolve()] if _is_track(folder) else _tracks_in(folder)
        tracks = [ViewedTrack(place, scans) for place in places if place.name not in known]
    except OSError as error:
        raise CommandError(f"{folder}: cannot be read ({error.strerror or error})", 2) from error
    if not places:
        raise CommandError(_what_else(folder), 2)
    for track in tracks:
        try:
            track.refresh()
        except (TrackFileError, SessionFolderError, OSError) as error:
            track.note = str(error)
    if not known and not any(track.rows for track in tracks):
        notes = "; ".join(f"{track.name}: {track.note or 'no frame yet'}" for track in tracks[:3])
        raise CommandError(f"{folder}: holds no tracked frame ({notes})")
    return tracks


def _is_track(folder: Path) -> bool:
    if (folder / TEMPLATE_STORY).is_file() or (folder / FRAMES).is_dir():
        return True
    try:
        report = read_json_file(folder / REPORT) or {}
    except SessionFolderError:
        return False
    return isinstance(report.get("sequence"), dict) and isinstance(report.get("items"), list)


def _tracks_in(folder: Path) -> list[Path]:
    return sorted(place for place in folder.iterdir() if place.is_dir() and _is_track(place))


def _what_else(folder: Path) -> str:
    """A sentence on a folder without a track: what it seems to be, and the command for that."""
    if has_records(folder) or (folder / MANIFEST).is_file():
        return (
            f"{folder}: holds a registered session, not a track; look at it with: corporeal curate {folder}"
        )
    if (folder / LIST).is_file():
        return f"{folder}: holds scans that are not tracked yet; do: corporeal track {folder} -o TRACKED"
    if (folder / ITEMS).is_file():
        return f"{folder}: holds a session of scans; register it: corporeal register {folder} -o REG"
    if any(folder.glob(f"*/{LIST}")):
        return f"{folder}: holds sequences of scans; track them: corporeal track {folder}/* -o TRACKED"
    if any(folder.glob("registration.npz")) or any(folder.glob("*/registration.npz")):
        return f"{folder}: holds a registration of one scan; its GLB opens in any glTF viewer"
    return (
        f"{folder}: holds no track; give what corporeal track wrote to (if it has just begun, wait "
        "for the template)"
    )
