"""What the player draws: the model, its scan over or beside it, the ground, and the camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import viser
from jaxtyping import Float, Float32, Int

from corporeal.view.track import ShownScan, Stance

_MODEL_COLOURS = {"ok": (236, 189, 161), "doubtful": (240, 190, 105), "failed": (214, 130, 122)}
_PLAIN = (92, 124, 158)
_STAGE = "/stage"
_THROUGH = 0.6
_LEFT = 0.4
_FIELD_OF_VIEW = np.radians(38)
_PLANES = ("yz", "xz", "xy")


@dataclass(frozen=True)
class Shown:
    """What is to be seen.

    Attributes:
        model: the model.
        scan: the scan.
        beside: the scan stands beside the model, not over it.
        errors: points of the scan have the colour of their distance to the model.
        follow: the camera goes along with the person.
    """

    model: bool = True
    scan: bool = True
    beside: bool = True
    errors: bool = True
    follow: bool = True


class PlayerScene:
    """The nodes of one track. One thread draws."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._mesh: Any = None
        self._cloud: Any = None
        self._stage: Any = None
        self._posed: np.ndarray | None = None
        self._drawn: ShownScan | None = None
        self._coloured = True
        self._status = ""

    def start(
        self, stance: Stance, vertices: Float32[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]
    ) -> None:
        """Begin with a track: everything before is removed, and the camera looks at the person's front.

        Args:
            stance: how the person stands when the track begins.
            vertices: (V, 3) of the model, metres.
            faces: (F, 3) of the model.
        """
        self._stance, size = stance, stance.size
        scene = self._server.scene
        with self._server.atomic():
            self.clear()
            scene.set_up_direction(tuple(stance.up))
            self._stage = scene.add_frame(_STAGE, show_axes=False)
            self._mesh = scene.add_mesh_simple(
                f"{_STAGE}/model",
                vertices,
                faces.astype(np.uint32),
                color=_MODEL_COLOURS["ok"],
                side="double",
            )
            # The browser complains of a cloud without points.
            self._cloud = scene.add_point_cloud(
                f"{_STAGE}/scan", np.zeros((1, 3), np.float32), _PLAIN, point_size=0.0035 * size,
                precision="float32", point_shape="circle", point_shading="flat", visible=False,
            )  # fmt: skip
            self._ground(stance)
        self._posed, self._drawn, self._status = vertices, None, ""
        to_the_right = np.cross(-stance.front, stance.up)
        self._sideways = to_the_right * max(0.62 * size, 1.1 * float(np.ptp(vertices @ to_the_right)))

    def clear(self) -> None:
        """Show nothing."""
        if self._stage is not None:
            self._stage.remove()
        self._stage = None

    def show(
        self, status: str, vertices: Float32[np.ndarray, "V 3"], scan: ShownScan | None, shown: Shown
    ) -> None:
        """Draw a frame.

        Args:
            status: of the frame.
            vertices: (V, 3) of the model, metres.
            scan: what there is of the scan; None for nothing.
            shown: what is to be seen.
        """
        with self._server.atomic():
            self._show_model(status, vertices, shown)
            self._show_scan(scan, shown)
            moved = vertices.mean(axis=0, dtype=np.float64) - self._stance.centre
            level = moved - (moved @ self._stance.up) * self._stance.up
            self._put(self._stage, -level if shown.follow else np.zeros(3))

    def reset_view(self, beside: bool) -> None:
        """Look at the person's front again, in all browsers."""
        if self._stage is not None:
            self._look(beside)

    def _show_model(self, status: str, vertices: Float32[np.ndarray, "V 3"], shown: Shown) -> None:
        self._mesh.visible = shown.model
        if not shown.model:
            return
        # While it stands, scans that come in are drawn, and the model need not be sent again.
        if self._posed is None or not np.array_equal(self._posed, vertices):
            self._mesh.vertices, self._posed = vertices, vertices
        opacity = None if shown.beside or not shown.scan else _THROUGH
        if self._mesh.opacity != opacity:
            self._mesh.opacity = opacity
        if status != self._status:
            self._mesh.color = _MODEL_COLOURS.get(status, _MODEL_COLOURS["failed"])
            self._status = status

    def _show_scan(self, scan: ShownScan | None, shown: Shown) -> None:
        visible = shown.scan and scan is not None and len(scan.points) > 0
        self._cloud.visible = visible
        if not visible or scan is None:
            return
        if scan is not self._drawn or shown.errors != self._coloured:
            plain = np.broadcast_to(np.array(_PLAIN, np.uint8), scan.colours.shape)
            self._cloud.points = scan.points
            self._cloud.colors = scan.colours if shown.errors else plain.copy()
            self._drawn, self._coloured = scan, shown.errors
        # Without a model beside it the scan stands in the middle.
        self._put(self._cloud, self._sideways if shown.beside and shown.model else np.zeros(3))

    def _put(self, node: Any, position: Float[np.ndarray, "3"]) -> None:
        if not np.allclose(node.position, position, atol=1e-6):
            node.position = position

    def _ground(self, stance: Stance) -> None:
        axis = int(np.abs(stance.up).argmax())
        place = stance.centre - (stance.centre @ stance.up - stance.floor) * stance.up
        size = stance.size
        self._server.scene.add_grid(
            f"{_STAGE}/ground", width=12 * size, height=12 * size, plane=_PLANES[axis],  # type: ignore[arg-type]
            cell_size=size / 4, section_size=size, cell_color=(226, 228, 231), section_color=(205, 208, 213),
            position=place, fade_distance=12 * size, shadow_opacity=0.2,
        )  # fmt: skip

    def _look(self, beside: bool) -> None:
        stance = self._stance
        # The panel covers the right: what is looked at stands left of the middle.
        centre = stance.centre + (0.5 * beside + _LEFT) * self._sideways
        eye = centre + stance.size * (1.95 * stance.front + 0.25 * stance.up)
        initial = self._server.initial_camera
        cameras: list[Any] = [initial, *(client.camera for client in self._server.get_clients().values())]
        for camera in cameras:
            camera.position, camera.look_at, camera.fov = eye, centre, float(_FIELD_OF_VIEW)
