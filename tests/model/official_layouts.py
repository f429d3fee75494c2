"""Makes files of the five official layouts with random content; no licensed file is needed.

Numbers are rounded to float32, since smplx rounds a file's arrays to it even when it computes in float64.
"""

import pickle
import struct
from pathlib import Path
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from corporeal.model.formats.families import FAMILIES, Family

# Vertices, faces, columns of "shapedirs" of real files (SMPL with 300 and SMPL+H with 16 columns exist too).
FULL_SIZES = {
    "mano": (778, 1538, 10),
    "smpl": (6890, 13776, 10),
    "smplh": (6890, 13776, 10),
    "smplx": (10475, 20908, 400),
    "flame": (5023, 9976, 400),
}
SMALL_COLUMNS = {"mano": 10, "smpl": 10, "smplh": 10, "smplx": 20, "flame": 20}
FAMILY_OF_NAME: dict[str, Family] = {family.name: family for family in FAMILIES}


def official_arrays(
    name: str, rng: np.random.Generator, size: tuple[int, int, int] | None = None, side: str = "right"
) -> dict[str, np.ndarray]:
    """The arrays of a random file of one family; ``size`` is vertices, faces and shape columns (or small)."""
    family = FAMILY_OF_NAME[name]
    V, F, C = size or (60, 90, SMALL_COLUMNS[name])
    K = len(family.parents)
    template = rng.normal(scale=0.2, size=(V, 3))
    # The root's vertices come first and at one end of x: a hand has its fingers on the other.
    template[: V // 10, 0] += 1.0 if side == "right" else -1.0
    arrays = {
        "v_template": _single(template),
        "f": np.stack([rng.permutation(V)[:3] for _ in range(F)]).astype(np.uint32),
        "shapedirs": rng.standard_normal((V, 3, C), dtype=np.float32) * np.float32(0.01),
        "posedirs": rng.standard_normal((V, 3, 9 * (K - 1)), dtype=np.float32) * np.float32(0.002),
        "J_regressor": _regressor(rng, K, V),
        "weights": _weights(rng, V, K),
        "kintree_table": np.array([family.parents, range(K)], dtype=np.int64).astype(np.uint32),
    }
    for block in family.blocks:
        if block.hand_suffix is not None:
            D = 3 * len(block.joints)
            arrays[f"hands_mean{block.hand_suffix}"] = _single(rng.normal(scale=0.3, size=D))
            components, _ = np.linalg.qr(rng.normal(size=(D, D)))
            arrays[f"hands_components{block.hand_suffix}"] = _single(components)
            arrays[f"hands_coeffs{block.hand_suffix}"] = _single(rng.normal(size=(20, D)))
    if family.expressions:
        barycentric = rng.dirichlet(np.ones(3), size=51)
        arrays["lmk_faces_idx"] = rng.integers(0, F, 51)
        arrays["lmk_bary_coords"] = barycentric
    return arrays


def write_npz(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    """As SMPL-X is distributed: float arrays and, for things nobody reads, pickled dictionaries."""
    np.savez(path, **arrays, joint2num=np.array({"pelvis": 0}, dtype=object), allow_pickle=True)
    return path


def write_plain_pickle(path: Path, arrays: dict[str, np.ndarray]) -> Path:
    """As converted by users for smplx: a dictionary of numpy arrays and a sparse regressor."""
    content = {**arrays, "J_regressor": sp.csc_matrix(arrays["J_regressor"]), "bs_type": "lrotmin"}
    path.write_bytes(pickle.dumps(content, protocol=2))
    return path


def write_chumpy_pickle(path: Path, arrays: dict[str, np.ndarray], sparse: str = "csc") -> Path:
    """As Python 2 wrote the official files: byte strings, chumpy arrays, old module paths."""
    V, _, C = arrays["shapedirs"].shape
    padded = np.zeros((V, 3, C + 2))
    padded[:, :, :C] = arrays["shapedirs"]
    chosen = np.arange(padded.size).reshape(padded.shape)[:, :, :C].ravel()
    template = Chumpy(x=arrays["v_template"])
    content = {
        **arrays,
        "shapedirs": ChumpySelect(a=Chumpy(x=padded), idxs=chosen, preferred_shape=(V, 3, C)),
        "v_template": ChumpyReshape(a=template, newshape=(V, 3)),
        "weights": ChumpyTranspose(a=Chumpy(x=np.ascontiguousarray(arrays["weights"].T)), axes=None),
        "J_regressor": SPARSE_STUBS[sparse](arrays["J_regressor"]),
        "bs_style": "lbs",
        "pose_training_info": {"gender": "neutral", "scans": [1, 2, 3]},
    }
    with path.open("wb") as stream:
        PythonTwoPickler(stream, protocol=2, fix_imports=True).dump(content)
    return path


class Chumpy:
    official_name = ("chumpy.ch", "Ch")

    def __init__(self, **state):
        self.__dict__.update(state, _dirty_vars={"x"}, _itr=None, _depends_on_deps={}, _status="new")


class ChumpySelect(Chumpy):
    official_name = ("chumpy.reordering", "Select")


class ChumpyReshape(Chumpy):
    official_name = ("chumpy.reordering", "Reshape")


class ChumpyTranspose(Chumpy):
    official_name = ("chumpy.reordering", "transpose")


class Csc:
    official_name = ("scipy.sparse.csc", "csc_matrix")
    convert = sp.csc_matrix

    def __init__(self, dense):
        matrix = type(self).convert(dense)
        self.__dict__.update(_shape=matrix.shape, maxprint=50, data=matrix.data)
        self.__dict__.update(indices=matrix.indices, indptr=matrix.indptr)


class Csr(Csc):
    official_name = ("scipy.sparse.csr", "csr_matrix")
    convert = sp.csr_matrix


class Coo:
    official_name = ("scipy.sparse.coo", "coo_matrix")

    def __init__(self, dense):
        matrix = sp.coo_matrix(dense)
        self.__dict__.update(_shape=matrix.shape, data=matrix.data, row=matrix.row, col=matrix.col)


SPARSE_STUBS = {"csc": Csc, "csr": Csr, "coo": Coo}


class PythonTwoPickler(pickle._Pickler):
    """Writes what Python 2 wrote: text as byte strings, classes under their official names."""

    dispatch: ClassVar[dict] = dict(pickle._Pickler.dispatch)

    def save_byte_string(self, value):
        raw = value.encode("latin1") if isinstance(value, str) else value
        self.write(pickle.BINSTRING + struct.pack("<i", len(raw)) + raw)
        self.memoize(value)

    dispatch[str] = dispatch[bytes] = save_byte_string

    def save_global(self, obj, name=None):
        if not hasattr(obj, "official_name"):
            super().save_global(obj, name)
            return
        module, official = obj.official_name
        self.write(pickle.GLOBAL + f"{module}\n{official}\n".encode())
        self.memoize(obj)


def _single(values):
    return values.astype(np.float32).astype(np.float64)


def _weights(rng, V, K):
    weights = np.zeros((V, K))
    for vertex in range(V):
        joints = rng.permutation(K)[:4]
        weights[vertex, joints] = rng.dirichlet(np.ones(len(joints)))
    return _single(weights)


def _regressor(rng, K, V):
    regressor = np.zeros((K, V))
    for joint in range(K):
        low, high = (0, V // 10) if joint == 0 else (V // 10, V)
        vertices = low + rng.permutation(high - low)[:6]
        regressor[joint, vertices] = rng.dirichlet(np.ones(len(vertices)))
    return _single(regressor)
