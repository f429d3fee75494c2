"""``corporeal view``: play the tracks of a folder in the browser, beside or over their scans."""

from __future__ import annotations

import webbrowser
from functools import partial

from rich.console import Console

from corporeal.cli.commands import View
from corporeal.cli.errors import CommandError
from corporeal.cli.viewed_tracks import find_tracks
from corporeal.export.track_sheet import WORST_MM
from corporeal.fitting.files import TrackFileError


def run(config: View) -> int:
    """Serve the page until Ctrl-C.

    Raises:
        CommandError: viser is missing, the folder holds no track, or no port can be listened on.
    """
    try:
        from corporeal.view.guarded_server import PortError
        from corporeal.view.player_page import PlayerPage
    except ImportError as error:
        raise CommandError("view: needs viser; install it with: pip install 'corporeal[view]'", 2) from error
    tracks = find_tracks(config.folder, config.scans)
    console = Console(stderr=True, markup=False, highlight=False, soft_wrap=True)
    for track in tracks:
        if track.note:
            console.print(f"{track.name}: {track.note}")
    try:
        # The first one's model is read here, so that a broken one ends the command and not the page.
        next(track for track in tracks if track.rows).stance()
        page = PlayerPage(tracks, partial(find_tracks, config.folder, config.scans), WORST_MM, config.port)
    except (TrackFileError, OSError, PortError) as error:
        raise CommandError(f"view: {error}", 2) from error
    if config.port not in (0, page.port):
        console.print(f"port {config.port} is taken; {page.port} serves instead")
    # On stdout and whole, so that programs can read it.
    print(page.url, flush=True)
    console.print("Ctrl-C ends the page")
    try:
        if config.browser:
            webbrowser.open(page.url)
        page.wait()
    except KeyboardInterrupt:
        pass
    finally:
        page.close()
    return 0
