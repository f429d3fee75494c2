"""Fills the start hand's template with tetrahedra, for its soft simulation; see README.md beside this file.

python assets/tetrahedralise_hand.py [--out FILE]

fTetWild does not promise the same numbers on every machine: the result is kept in the repository, and has
to be made again only when the template changes.
"""

from __future__ import annotations

import argparse
import io
from pathlib import Path

import numpy as np
from hand_simulator.tetrahedra import tetrahedralised
from open_hand.soft_hand import TETRAHEDRA

from corporeal.atomic import write_bytes
from corporeal.model.files import open_model


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=TETRAHEDRA)
    options = parser.parse_args()
    model = open_model("start_hand")
    vertices, tets = tetrahedralised(model.template, model.faces)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, tet_vertices=vertices, tets=tets)
    write_bytes(options.out, buffer.getvalue())
    print(f"{options.out}: {len(buffer.getvalue()) / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
