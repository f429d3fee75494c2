import base64
import json
import struct

import numpy as np
import pytest
import trimesh

from corporeal.scans.files import ScanFileError, read_scan, read_scan_points

BALL = trimesh.creation.icosphere(subdivisions=2, radius=100.0)
POINTS = np.asarray(BALL.vertices) * [1.5, 1.0, 0.6] + [300.0, -40.0, 7.0]
FACES = np.asarray(BALL.faces, dtype=np.int64)
COLOURS = np.random.default_rng(5).integers(0, 256, POINTS.shape).astype(np.uint8)
MESH = trimesh.Trimesh(POINTS, FACES, vertex_colors=np.c_[COLOURS, np.full(len(POINTS), 255)], process=False)


def write(tmp_path, name: str, data: bytes | str):
    path = tmp_path / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def assert_is_the_mesh(scan, tolerance=1e-7, coloured=True):
    """Same triangles at the same places, whatever the order of the points."""
    places = scan.points[scan.faces].mean(axis=1)
    expected = POINTS[FACES].mean(axis=1) / 1000
    order, expected_order = (np.lexsort(np.round(p, 5).T) for p in (places, expected))
    np.testing.assert_allclose(places[order], expected[expected_order], atol=tolerance)
    assert len(scan.points) == len(POINTS)
    assert scan.unit.name == "mm"
    if coloured:
        point_order, expected_point_order = (
            np.lexsort(np.round(p, 5).T) for p in (scan.points, POINTS / 1000)
        )
        np.testing.assert_array_equal(scan.colours[point_order], COLOURS[expected_point_order])


def ply(encoding: str, vertex_kind="float", with_edges=False, with_quad=False) -> bytes:
    """A PLY with an unknown property, colours, faces that may differ in size, and a table after them."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[encoding]
    polygons = [list(face) for face in FACES]
    if with_quad:
        polygons = [*quad_of_the_first_faces(), *polygons]
    header = ["ply", f"format {encoding} 1.0", "comment made by a test", f"element vertex {len(POINTS)}"]
    header += [f"property {vertex_kind} {axis}" for axis in "xyz"]
    header += ["property float confidence", *(f"property uchar {name}" for name in ("red", "green", "blue"))]
    header += [
        f"element face {len(polygons)}",
        "property list uchar int vertex_indices",
        "property uchar flags",
    ]
    header += ["element edge 2", "property int vertex1", "property int vertex2"] if with_edges else []
    text = "\n".join([*header, "end_header", ""])
    rows: list[tuple[str, tuple]] = []
    real = "d" if vertex_kind == "double" else "f"
    rows += [(real * 3 + "fBBB", (*p, 0.5, *map(int, c))) for p, c in zip(POINTS, COLOURS, strict=True)]
    rows += [("B" + "i" * len(f) + "B", (len(f), *map(int, f), 7)) for f in polygons]
    rows += [("ii", (0, 1)), ("ii", (1, 2))] if with_edges else []
    if encoding == "ascii":
        return (text + "\n".join(" ".join(map(str, values)) for _, values in rows) + "\n").encode()
    return text.encode() + b"".join(struct.pack(order + kind, *values) for kind, values in rows)


def quad_of_the_first_faces() -> list[list[int]]:
    """A quad over face 0 and the one across its first edge: its triangles are both there already."""
    a, b, c = FACES[0]
    across = next(f for f in FACES[1:] if a in f and b in f)
    (d,) = set(across.tolist()) - {a, b}
    return [[int(a), int(d), int(b), int(c)]]


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("extras", [{}, {"vertex_kind": "double"}, {"with_edges": True}])
def test_ply_of_every_encoding(tmp_path, encoding, extras):
    assert_is_the_mesh(read_scan(write(tmp_path, "a.ply", ply(encoding, **extras))), 1e-7)


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_with_quads_among_triangles(tmp_path, encoding):
    scan = read_scan(write(tmp_path, "a.ply", ply(encoding, with_quad=True, with_edges=True)))
    # The quad's fan uses the other diagonal or the same one; in either case no point is lost or moved.
    assert len(scan.points) == len(POINTS)
    assert len(scan.faces) in (len(FACES), len(FACES) + 2)


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.ply", MESH.export(file_type="ply", encoding="ascii")),
        ("a.PLY", MESH.export(file_type="ply", encoding="binary")),
        ("a.obj", MESH.export(file_type="obj", include_color=True)),
        ("a.glb", MESH.export(file_type="glb")),
    ],
)
def test_reads_what_trimesh_writes_with_colour(tmp_path, name, data):
    assert_is_the_mesh(read_scan(write(tmp_path, name, data)), 1e-6)


@pytest.mark.parametrize("kind", ["stl", "stl_ascii", "off"])
def test_reads_what_trimesh_writes_without_colour(tmp_path, kind):
    suffix = kind.partition("_")[0]
    scan = read_scan(write(tmp_path, f"a.{suffix}", MESH.export(file_type=kind)))
    assert_is_the_mesh(scan, 1e-6, coloured=False)
    assert scan.colours is None
    assert scan.name == "a" and scan.source == f"a.{suffix}"


def test_binary_stl_that_begins_with_solid(tmp_path):
    data = b"solid by a scanner".ljust(80) + MESH.export(file_type="stl")[80:]
    assert_is_the_mesh(read_scan(write(tmp_path, "a.stl", data)), 1e-6, coloured=False)


@pytest.mark.parametrize(
    "header", ["COFF\n{n} {m} 0\n", "COFF {n} {m} 0\n# a comment\n", "OFF\r\n{n} {m}\r\n"]
)
@pytest.mark.parametrize("alpha", [" 255", ""])
def test_coff_in_its_spellings(tmp_path, header, alpha):
    lines = [
        f"{p[0]!r} {p[1]!r} {p[2]!r} {c[0]} {c[1]} {c[2]}{alpha}"
        for p, c in zip(POINTS.tolist(), COLOURS, strict=True)
    ]
    lines += [f"3 {a} {b} {c} 200 200 200" for a, b, c in FACES]
    text = header.format(n=len(POINTS), m=len(FACES)) + "\n".join(lines)
    assert_is_the_mesh(read_scan(write(tmp_path, "a.off", text)))


def test_noff_and_colours_from_0_to_1(tmp_path):
    lines = [
        " ".join(map(repr, [*p, 0.0, 0.0, 1.0, *(c / 255).tolist()]))
        for p, c in zip(POINTS.tolist(), COLOURS, strict=True)
    ]
    lines += [f"3 {a} {b} {c}" for a, b, c in FACES]
    text = f"CNOFF\n{len(POINTS)} {len(FACES)} 0\n" + "\n".join(lines)
    assert_is_the_mesh(read_scan(write(tmp_path, "a.off", text)))


def test_obj_with_negative_indices_seams_and_quads(tmp_path):
    text = "mtllib ../../etc/passwd\no thing\nvt 0 0\nvt 1 1\nvn 0 0 1\n"
    text += "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in POINTS.tolist())
    for number, face in enumerate(FACES):
        if number % 2:
            text += "f " + " ".join(f"{v - len(POINTS)}/{1 + number % 2}/1" for v in face) + "\n"
        else:
            text += "f \\\n " + " ".join(f"{v + 1}//1" for v in face) + " # a comment\n"
    text += "v 900 900 900\n"  # after the faces: must not shift the negative indices before it
    assert_is_the_mesh(read_scan(write(tmp_path, "a.obj", text)), coloured=False)


def test_point_clouds_of_ply_obj_and_glb(tmp_path, rng):
    points = rng.normal(size=(500, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True) * 10
    cloud = trimesh.PointCloud(points, colors=np.full((500, 4), [10, 20, 30, 255]))
    files = {
        "a.ply": cloud.export(file_type="ply"),
        "a.obj": "".join(f"v {x!r} {y!r} {z!r} 10 20 30\n" for x, y, z in points.tolist()),
        "a.glb": trimesh.Scene(cloud).export(file_type="glb"),
    }
    for name, data in files.items():
        scan = read_scan(write(tmp_path, name, data))
        assert scan.is_point_cloud and scan.unit.name == "m"
        np.testing.assert_allclose(scan.points, points, atol=1e-7)
        assert (scan.colours == [10, 20, 30]).all()
        assert (np.einsum("ni,ni->n", scan.normals, points) > 0.09).all()


def test_ply_cloud_keeps_its_normals(tmp_path, rng):
    points = rng.normal(size=(300, 3))
    header = "ply\nformat ascii 1.0\nelement vertex 300\n"
    header += (
        "".join(f"property double {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz")) + "end_header\n"
    )
    rows = "".join(" ".join(map(repr, [*p, 0.0, 0.0, 2.0])) + "\n" for p in points.tolist())
    scan = read_scan(write(tmp_path, "a.ply", header + rows), unit="cm")
    np.testing.assert_array_equal(scan.normals, np.tile([0.0, 0.0, 1.0], (len(scan.points), 1)))


def test_scene_is_merged_at_its_places(tmp_path):
    half = POINTS[FACES].mean(axis=1)[:, 0] > 300
    place = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3], [4, 5, 6])
    mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
    scene = trimesh.Scene()
    for matrix, faces in ((place, FACES[half]), (mirror, FACES[~half][:, ::-1])):
        local = trimesh.transform_points(POINTS, np.linalg.inv(matrix))
        scene.add_geometry(trimesh.Trimesh(local, faces, process=False), transform=matrix)
    scan = read_scan(write(tmp_path, "a.glb", scene.export(file_type="glb")))
    assert_is_the_mesh(scan, 1e-6, coloured=False)
    assert not any("inside out" in sentence or "windings" in sentence for sentence in scan.repairs)


def test_gltf_reads_buffers_beside_it_and_nowhere_else(tmp_path):
    files = trimesh.Scene(MESH).export(file_type="gltf")
    for name, data in files.items():
        write(tmp_path, "a.gltf" if name == "model.gltf" else name, data)
    assert_is_the_mesh(read_scan(tmp_path / "a.gltf"), 1e-6)
    document = json.loads((tmp_path / "a.gltf").read_text())
    inside = json.loads(json.dumps(document))
    for buffer in inside["buffers"]:
        payload = base64.b64encode((tmp_path / buffer["uri"]).read_bytes()).decode()
        buffer["uri"] = "data:application/octet-stream;base64," + payload
    assert_is_the_mesh(read_scan(write(tmp_path, "b.gltf", json.dumps(inside))), 1e-6)
    for uri in ("../secret.bin", "/etc/passwd", "..%2Fsecret.bin"):
        document["buffers"][0]["uri"] = uri
        (tmp_path / "inner").mkdir(exist_ok=True)
        with pytest.raises(ScanFileError, match="outside of its folder"):
            read_scan(write(tmp_path / "inner", "c.gltf", json.dumps(document)))


def test_units_scale_but_never_move(tmp_path):
    path = write(tmp_path, "a.ply", ply("ascii", "double"))
    for unit, scale in (("auto", 1e-3), ("mm", 1e-3), ("cm", 1e-2), ("m", 1.0)):
        extent = (300 * scale, 500 * scale)
        scan = read_scan(path, unit, expected_extent=extent)
        np.testing.assert_allclose(scan.points, POINTS * scale, rtol=1e-12)
    free = read_scan(path, "free")
    np.testing.assert_allclose(free.in_own_unit(free.points), POINTS, rtol=1e-12)
    assert 0.08 < free.diagonal < 0.9
    with pytest.raises(ScanFileError, match=r"a\.ply.*--unit"):
        read_scan(path, expected_extent=(1.2, 2.3))


@pytest.mark.parametrize(
    ("name", "data", "message"),
    [
        ("a.xyz", b"1 2 3", "ends in .ply"),
        ("a.ply", b"", "empty"),
        ("a.ply", b"plymouth", "end_header"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 0\nend_header\n", "'vertex'"),
        ("a.ply", ply("binary_little_endian")[:-9], "cut off"),
        ("a.ply", ply("ascii")[:-500], "cut off"),
        ("a.off", b"OFF\n8 6 0\n0 0 0\n", "8 vertices and 6 faces"),
        ("a.off", b"4OFF\n1 0 0\n0 0 0 0\n", "4D"),
        ("a.stl", MESH.export(file_type="stl")[:-7], "cut off"),
        ("a.stl", b"solid x\nfacet\nvertex 0 0 0\nendfacet\nendsolid", "three in each"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "refers to vertex 3"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "begin with 1"),
        ("a.obj", b"v 0 0 0\nv 1 0 zero\n", "zero"),
        ("a.glb", b"glTF" + bytes(30), "version 0"),
        ("a.gltf", b"[" * 100000, "JSON"),
    ],
)
def test_wrong_files_are_refused_by_name(tmp_path, name, data, message):
    with pytest.raises(ScanFileError, match=message) as caught:
        read_scan(write(tmp_path, name, data))
    assert name in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ScanFileError, match=r"none\.ply.*No such file"):
        read_scan(tmp_path / "none.ply")


HUGE = 10**13


def ply_header(*lines: str) -> bytes:
    return ("\n".join(["ply", *lines, "end_header", ""])).encode()


def glb_with(change) -> bytes:
    data = MESH.export(file_type="glb")
    length = struct.unpack_from("<I", data, 12)[0]
    document = json.loads(data[20 : 20 + length])
    change(document)
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


def _without_data(document):
    for accessor in document["accessors"]:
        accessor.update(count=HUGE)
        accessor.pop("bufferView")


@pytest.mark.parametrize(
    ("name", "data"),
    [
        ("a.ply", ply_header("format ascii 1.0", f"element vertex {HUGE}", "property float x") + b"1\n"),
        (
            "a.ply",
            ply_header("format binary_little_endian 1.0", f"element vertex {HUGE}", "property float x"),
        ),
        (
            "a.ply",
            ply_header("format binary_little_endian 1.0", "element face 1", "property list uint double v")
            + b"\xff" * 40,
        ),
        ("a.ply", ply_header("format ascii 1.0", f"element vertex {HUGE}", f"element face {HUGE}")),
        (
            "a.ply",
            ply_header("format ascii 1.0", "element face 1", "property list uint double v") + b"1e15 1 2 3",
        ),
        ("a.off", f"OFF\n{HUGE} {HUGE} 0\n".encode()),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n" + str(HUGE).encode() + b" 0 1 2\n"),
        ("a.stl", bytes(80) + struct.pack("<I", 0xFFFFFFFF) + bytes(500)),
        ("a.glb", glb_with(_without_data)),
        ("a.glb", glb_with(lambda d: d["nodes"].extend([{"children": [0, 0]}] * 40))),
    ],
)
def test_huge_counts_are_refused_before_memory_is_taken(tmp_path, name, data):
    with pytest.raises(ScanFileError):
        read_scan(write(tmp_path, name, data))


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "points", "faces", "diagonal"),
    [
        ("hand-scan2knit/hand5.off", 2502, 5000, 0.31626),
        ("hand-sense/hand1.stl", 9346, 18688, 0.29200),
        ("hand-sense/hand3.stl", 40304, 80604, 0.35941),
    ],
)
def test_real_hands(shared_data, name, points, faces, diagonal):
    scan = read_scan(shared_data / "scans" / name)
    assert (len(scan.points), len(scan.faces)) == (points, faces)
    assert scan.unit.name == "mm"
    assert scan.diagonal == pytest.approx(diagonal, abs=1e-4)
    mesh = trimesh.Trimesh(scan.points, scan.faces, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    np.testing.assert_allclose(np.linalg.norm(scan.normals, axis=1), 1, atol=1e-9)
    # trimesh weighs normals by angle too; it stands as the oracle for their direction.
    assert np.einsum("ni,ni->n", scan.normals, mesh.vertex_normals).min() > 0.99
    assert (scan.colours is not None) == name.endswith(".off")


@pytest.mark.real_data
def test_a_draco_file_is_unpacked(shared_data):
    scan = read_scan(shared_data / "scans" / "head-leeperry" / "LeePerrySmith.glb", "free")
    points = scan.in_own_unit(scan.points)
    # What the file says of its positions, which Draco rounds to 14 bits.
    np.testing.assert_allclose(points.min(0), [-4.2805, -3.9767, -2.5946], atol=0.01)
    np.testing.assert_allclose(points.max(0), [4.2805, 3.9784, 2.5947], atol=0.01)
    assert 17_650 < len(scan.faces) <= 17_684  # of the file's, degenerate ones are dropped
    assert np.einsum("na,na->n", scan.normals, points - points.mean(0)).mean() > 0


def test_points_to_look_at_are_those_of_the_file_in_metres_without_broken_ones(tmp_path):
    lines = [*(f"v {x} {y} {z}" for x, y, z in POINTS.tolist()), "v nan 0 0", "v 0 inf 0", "v 1e12 0 0"]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES.tolist()]
    path = write(tmp_path, "a.obj", "\n".join(lines))
    for unit in ("auto", "mm"):
        np.testing.assert_allclose(read_scan_points(path, unit), POINTS / 1000, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "data", "unit", "words"),
    [
        ("a.ply", b"", "mm", "a.ply: the file is empty"),
        ("a.ply", b"ply\nbroken", "mm", "a.ply: cannot be read as PLY"),
        ("a.txt", b"0 0 0", "mm", "a.txt: expected a file that ends in"),
        ("a.obj", b"v nan 0 0\nv 0 nan 0\nv 0 0 nan\nf 1 2 3\n", "mm", "a.obj: .* no point with finite"),
        ("a.ply", ply("ascii"), "m", "a.ply: "),
    ],
)
def test_points_that_cannot_be_looked_at_name_the_file(tmp_path, name, data, unit, words):
    with pytest.raises(ScanFileError, match=words):
        read_scan_points(write(tmp_path, name, data), unit)
    with pytest.raises(ScanFileError, match="missing"):
        read_scan_points(tmp_path / "missing.ply")
