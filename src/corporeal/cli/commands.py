"""What can be asked for on the command line: options alone, so that help and version need no library."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro


@dataclass(frozen=True)
class Register:
    """Register raw scans of hands, people or heads: no landmarks to place.

    Attributes:
        scans: scan files (PLY, OBJ, STL, OFF, GLB), meshes or point clouds; or the folder of a session.
        output: folder that gets one folder of results per scan, or the records of a session.
        model: "hand", "body" or "head" for the open models in the box, or a model file.
        side: which hand it is; auto finds out.
        unit: unit of the files; auto guesses from the size, free estimates the scale of photographed scans.
        landmarks: JSON or CSV with landmarks of the one scan, in its own unit; then no detector is asked.
        correctives: use the model's pose correctives.
        green_objects: drop points painted green (G > max(R, 20)), as objects were in MANO's captures.
        json: also write the machine-readable result to this file.
        workers: processes for a session; as many as there are cores if not given.
        rounds: 2 registers a session again with the pose priors that its first round taught.
        dask: register a session on dask.distributed: a scheduler's address, or local.
        restart: throw away what the output folder holds of a session, and begin anew.
        outputs: write GLB, PLYs and a picture for every scan of a session too.
        landmarks_from: folder of an earlier registration of the session, whose landmarks are used again: the
            detector takes as long as a fit.
    """

    scans: tyro.conf.Positional[tuple[Path, ...]]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    model: str = "hand"
    side: Literal["auto", "left", "right"] = "auto"
    unit: Literal["auto", "m", "cm", "mm", "free"] = "auto"
    landmarks: Path | None = None
    correctives: bool = True
    green_objects: bool = False
    json: Path | None = None
    workers: int | None = None
    rounds: Literal[1, 2] = 1
    dask: str | None = None
    restart: bool = False
    outputs: bool = False
    landmarks_from: Path | None = None


@dataclass(frozen=True)
class Info:
    """Say what a file holds: a model (ours or an official one) or a scan.

    Attributes:
        file: model file, scan file, or the name of a model in the box ("hand", "body", "head").
        json: also write the machine-readable result to this file.
    """

    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")]
    json: Path | None = None


@dataclass(frozen=True)
class Convert:
    """Convert a model file: research pickles to archives, official layouts to ours and back.

    Attributes:
        source: MANO, SMPL, SMPL+H, SMPL-X or FLAME file (.pkl or .npz), one of ours, or hand (the open one).
        target: file to write, .npz or .pkl.
        right: for a left-hand MANO file, the right-hand one: finds the known fault of left hands.
        repair_left: repair that fault where it is found.
        layout: native keeps everything; official writes the family's keys alone.
        precision: in which shape, expression and pose directions are stored.
        json: also write the machine-readable result to this file.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IN")]
    target: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")]
    right: Path | None = None
    repair_left: bool = False
    layout: Literal["native", "official"] = "native"
    precision: Literal["float64", "float32", "float16"] = "float64"
    json: Path | None = None


@dataclass(frozen=True)
class Merge:
    """Join a hand model to a body: fingers from the hand, the rest, the wrist and the shapes from the body.

    Attributes:
        body: SMPL, SMPL+H or SMPL-X file, one of ours, or the name of a model in the box.
        hand: MANO file or hand of ours, of either side; the other side is its mirror image.
        output: the model file (.npz or .pkl).
        other_hand: the hand of the other side, if it is not to be mirrored.
        vertices: file (.npz or .pkl) with left_hand and right_hand, the body's index of every hand vertex;
            needed for bodies without fingers and where the two meshes differ.
        hand_pose: pca, or full: all components are kept.
        hand_components: of each hand's pose space that are kept with pca.
        most_joints: that move one vertex; renderers take four. All are kept if not given.
        seam_width: millimetres behind the seam over which the hand is faded in.
        seam_poses: random poses in which the seam is measured.
        name: of the model.
        layout: native keeps everything; official writes the family's keys alone.
        precision: in which shape, expression and pose directions are stored.
        json: also write the machine-readable result to this file.
    """

    body: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="BODY")]
    hand: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="HAND")]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    other_hand: Path | None = None
    vertices: Path | None = None
    hand_pose: Literal["pca", "full"] = "pca"
    hand_components: int = 6
    most_joints: int | None = None
    seam_width: float = 30.0
    seam_poses: int = 200
    name: str | None = None
    layout: Literal["native", "official"] = "native"
    precision: Literal["float64", "float32", "float16"] = "float64"
    json: Path | None = None


@dataclass(frozen=True)
class Simulate:
    """Simulate a capture with its truth: hands in protocol poses, or with --body people in motion.

    Attributes:
        output: folder of the session or of the sequences; an interrupted one is continued.
        subjects: number of people; 31 for hands, one for every two sequences for bodies.
        poses: number of protocol poses; every hand does about five eighths of them.
        seed: everything follows from it.
        sides: which hands.
        objects: put green objects into grasps.
        bad_one_in: one scan in so many is spoilt on purpose; 0 for none.
        natural_share: share of scans that show a pose of no protocol, between recorded ones.
        body: 4D sequences of people, 60 frames a second; mesh, skinning and shapes are not the open body's.
        sequences: number of sequences of bodies; 1 if not given.
        frames: of each sequence; 200 if not given.
        workers: processes; 0 for one per core.
        json: also write the machine-readable result to this file.
    """

    output: tyro.conf.Positional[Path]
    subjects: int | None = None
    poses: int = 51
    seed: int = 0
    sides: Literal["both", "right", "left"] = "both"
    objects: bool = False
    bad_one_in: int = 40
    natural_share: float = 0.15
    body: bool = False
    sequences: int | None = None
    frames: int | None = None
    workers: int = 0
    json: Annotated[Path | None, tyro.conf.arg()] = None


@dataclass(frozen=True)
class Track:
    """Track people through sequences of scans: a personal template first, then the pose of every frame.

    No landmarks to place, no options needed. What is done is kept: the same command goes on where it stopped.

    Attributes:
        sequences: folders with a sequence.json, or folders of scan files, one file per frame.
        output: folder that gets one folder of results per sequence.
        model: "body" for the open body in the box, or a model file.
        workers: sequences tracked at the same time; as many as there are cores if not given.
        dask: track on dask.distributed: a scheduler's address, or local.
        meshes: write a mesh per frame too.
        restart: throw away what the output folder holds of these sequences, and begin anew.
        json: also write the machine-readable result to this file; - for the standard output.
        template: the subject's own model (template.npz of an earlier run): none is learned then.
        template_frames: frames that the template is learned from, at most; 50 if not given.
        frames: track so many frames of every sequence; all if not given.
        start: registration.npz of the first frame of the one sequence (of corporeal register, for instance
            with landmarks); then no detector is asked.
    """

    sequences: tyro.conf.Positional[tuple[Path, ...]]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    model: str = "body"
    workers: int | None = None
    dask: str | None = None
    meshes: bool = False
    restart: bool = False
    json: Path | None = None
    template: Path | None = None
    template_frames: int | None = None
    frames: int | None = None
    start: Path | None = None


@dataclass(frozen=True)
class Curate:
    """Curate a registered session in the browser, on this machine only.

    Keys: a accept, r reject, u undo, right and left for the next and the previous scan. Every decision is
    written to decisions.jsonl in the folder before the page goes on.

    Attributes:
        folder: what ``corporeal register SESSION -o`` wrote to.
        session: folder of the scans, if it has been moved since.
        port: to listen on; if it is taken, the next free one.
        browser: open the page in the default browser.
    """

    folder: tyro.conf.Positional[Path]
    session: Path | None = None
    port: int = 8080
    browser: bool = True


@dataclass(frozen=True)
class View:
    """Play tracked sequences in the browser beside or over their scans, on this machine only.

    Keys: space plays and pauses, right and left step, home and end, n and p go to the next and the previous
    frames that are not ok. What a running track has written so far is shown; refresh reads the rest.

    Attributes:
        folder: what ``corporeal track -o`` wrote to, or one sequence in it.
        scans: folder of the scans, if it has been moved since: that of the sequence, or that above several.
        port: to listen on; if it is taken, the next free one.
        browser: open the page in the default browser.
    """

    folder: tyro.conf.Positional[Path]
    scans: Path | None = None
    port: int = 8080
    browser: bool = True


@dataclass(frozen=True)
class Report:
    """Report on a registered session: counts, distances, the worst, and errors where a truth exists.

    Attributes:
        folder: what ``corporeal register SESSION -o`` wrote to.
        output: the HTML file; without it report.html in the folder.
        session: folder of the scans and of their truth, if it has been moved since.
        json: also write the machine-readable result to this file.
    """

    folder: tyro.conf.Positional[Path]
    output: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    session: Path | None = None
    json: Path | None = None


@dataclass(frozen=True)
class Joints:
    """Place a start model's joints by scans, before a session is registered with it.

    Registrations slide where a joint of the model lies wrong in its skin, and what is learned from them keeps
    it there. Poses, shapes and joints are fitted to scans together, without free vertices.

    Attributes:
        registrations: folder that ``corporeal register SESSION -o`` wrote to; a first, rough one will do.
        output: the model file (.npz).
        start: the model whose joints are moved; the one that the session was registered with, if not given.
        scans: of every person, evenly from the least bent to the most.
        name: of the model; the start's name if not given.
        precision: in which shape, expression and pose directions are stored.
        json: also write the machine-readable result to this file.
    """

    registrations: tyro.conf.Positional[Path]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    start: str | None = None
    scans: int = 12
    name: str | None = None
    precision: Literal["float64", "float32", "float16"] = "float64"
    json: Path | None = None


@dataclass(frozen=True)
class Learn:
    """Learn a model from registered sessions: shape, joints, skinning weights, pose correctives, pose PCA.

    What the curator accepted is used, and of what was not curated, what is "ok". Left hands are mirrored in.

    Attributes:
        registrations: folders that ``corporeal register SESSION -o`` wrote to.
        output: the model file (.npz); beside it, personal templates, poses and log as NAME.learning.npz.
        start: the model that they were registered with, if it is not in the folder: hand, or a file.
        name: of the model; the start's name if not given.
        sides: both (left ones are mirrored in), or right-only.
        correctives: learn pose correctives.
        regularisation: of the correctives: by geodesic distance (MANO) or constant (SMPL).
        corrective_strength: what holds the correctives back, for a hand; for what is larger, less by the
            square of its size.
        hinges: joints that the start model's recorded poses show to be hinges turn about their axes alone.
        neutral_first: weigh registrations by their distance from the zero pose in the first templates.
        start_shape_weight: weight of the start model's shape covariance, added to that of the learned people:
            for few people.
        seed: of the pose mixture.
        pictures: draw the components, and write a GLB, beside the model.
        json: also write the machine-readable result to this file.
    """

    registrations: tyro.conf.Positional[tuple[Path, ...]]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    start: str | None = None
    name: str | None = None
    sides: Literal["both", "right-only"] = "both"
    correctives: bool = True
    regularisation: Literal["geodesic", "constant"] = "geodesic"
    corrective_strength: float = 5.0
    hinges: bool = True
    neutral_first: bool = True
    start_shape_weight: float = 0.0
    seed: int = 0
    pictures: bool = False
    json: Path | None = None


@dataclass(frozen=True)
class Pipeline:
    """From a capture session to a model: register, learn, register with what was learned, learn again.

    What is done is kept: the same command goes on where it stopped, and redoes what has changed since.

    Attributes:
        session: folder of a capture session; with --simulate it is made, or finished.
        output: folder of the rounds and of the model.
        rounds: of registering and learning.
        simulate: simulate the session.
        subjects: number of people to simulate.
        poses: number of protocol poses to simulate.
        seed: of the simulation and of the pose mixture.
        wait_for_curation: stop after every registration until it has been curated.
        workers: processes; as many as there are cores if not given.
        start: the model that the first round registers with: hand, or a file.
        name: of the model; the start's name if not given.
        pictures: draw the components, and write a GLB, beside the model.
        restart: throw away the registrations that are there, and begin anew.
        json: also write the machine-readable result to this file.
    """

    session: tyro.conf.Positional[Path]
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    rounds: int = 2
    simulate: bool = False
    subjects: int = 31
    poses: int = 51
    seed: int = 0
    wait_for_curation: bool = False
    workers: int | None = None
    start: str = "hand"
    name: str | None = None
    pictures: bool = False
    restart: bool = False
    json: Path | None = None


@dataclass(frozen=True)
class Evaluate:
    """Evaluate a learned model on a held-out session: generalisation, comparisons, compactness, truth.

    Attributes:
        model: what ``corporeal learn`` wrote, with its NAME.learning.npz beside it.
        test: folder that ``corporeal register`` wrote to, of a session of other people.
        output: folder for evaluation.json, evaluation.md, plots, and the models learned for comparison.
        train: folders that the model was learned from: for comparisons with models learned otherwise.
        start: the model that learning began with: hand, or a file; else the one of the first --train.
        asset: a model that was made without flesh or scans, to be compared with where the start is a better
            one: start_hand, or a file; else the start.
        scored: protocol pose whose scans are scored.
        variants: learn the models to compare with; without it only the given one is evaluated.
        workers: processes; as many as there are cores if not given.
        json: also write the machine-readable result to this file.
    """

    model: tyro.conf.Positional[Path]
    test: Path
    output: Annotated[Path, tyro.conf.arg(aliases=["-o"])]
    train: tuple[Path, ...] = ()
    start: str | None = None
    asset: str | None = None
    scored: str = "natural"
    variants: bool = True
    workers: int | None = None
    json: Path | None = None
