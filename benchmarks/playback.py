"""What a frame of the player costs: vertices sent against bones, frames posed together against alone.

    python benchmarks/playback.py [--json FILE] [--baseline FILE]

The open body, 18,056 vertices and 55 joints. "sent": what the server spends on handing one frame to viser,
by the vertices of its mesh, against by the bones of its skinned mesh (two messages a bone; correctives are
lost).
"posed": sixteen frames at once in plain torch and float32, as the player does, against one after the other by
the float64 kernels that fitting uses. "browser": updates of the mesh a second that arrive in a headless
Chromium without a GPU, where 60 are sent: nearly all of its time goes into drawing.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch
import viser
from measure import Row, paired_ratio, report
from playwright.sync_api import sync_playwright

from corporeal.model.files import open_model
from corporeal.model.jacobian import evaluate
from corporeal.model.pose import FullPose
from corporeal.model.reference import reference_surface
from corporeal.model.surface_model import SurfaceModel

FRAMES = 16
REPEATS = 15
SECONDS = 8.0
CHROMIUM = Path("/usr/bin/chromium")
FLAGS = ["--no-sandbox", "--disable-gpu", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
COUNTED = """
window.updates = 0;
const sent = WebGL2RenderingContext.prototype.bufferSubData;
WebGL2RenderingContext.prototype.bufferSubData = function(target, offset, data) {
    if (data && data.byteLength === BYTES) window.updates++;
    return sent.apply(this, arguments);
};
"""


class Scene:
    """A viser server with the body twice: as a mesh, and skinned."""

    def __init__(self, model: SurfaceModel, surfaces: np.ndarray) -> None:
        self.surfaces, self.number = surfaces, 0
        self.server = viser.ViserServer(host="127.0.0.1", port=8765, verbose=False)
        faces, joints = model.faces.astype(np.uint32), np.asarray(model.joint_regressor @ model.template)
        still = np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1))
        scene = self.server.scene
        scene.set_up_direction("+y")
        self.mesh = scene.add_mesh_simple("/mesh", surfaces[0], faces)
        self.skinned = scene.add_mesh_skinned(
            "/skinned", model.template.astype(np.float32), faces, bone_wxyzs=still, bone_positions=joints,
            skin_weights=model.skinning_weights.astype(np.float32), visible=False,
        )  # fmt: skip

    def send_vertices(self) -> None:
        """The next frame, exact."""
        self.number += 1
        with self.server.atomic():
            self.mesh.vertices = self.surfaces[self.number % FRAMES]

    def send_bones(self) -> None:
        """As many bones in a new pose."""
        self.number += 1
        angle = 0.01 * self.number
        with self.server.atomic():
            for bone in self.skinned.bones:
                bone.wxyz = (np.cos(angle), np.sin(angle), 0.0, 0.0)
                bone.position = (0.0, angle, 0.0)


def updates_per_second(scene: Scene) -> float:
    """Send 60 frames a second to a browser; how many a second it takes over."""
    script = COUNTED.replace("BYTES", str(scene.surfaces[0].nbytes))
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=str(CHROMIUM), args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.add_init_script(script)
        page.goto(f"http://127.0.0.1:{scene.server.get_port()}")
        page.wait_for_timeout(6000)
        before, begun = page.evaluate("window.updates"), time.perf_counter()
        while time.perf_counter() - begun < SECONDS:
            scene.send_vertices()
            time.sleep(1 / 60)
        arrived, passed = page.evaluate("window.updates") - before, time.perf_counter() - begun
        browser.close()
    # A mesh keeps its vertices in two buffers of the same size: places and normals.
    return arrived / 2 / passed


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--baseline", type=Path)
    arguments = parser.parse_args()
    model = open_model("body")
    poses = 0.2 * np.random.default_rng(0).standard_normal((FRAMES, model.joint_count, 3))
    matrices, tensors = FullPose(torch.from_numpy(poses).float()).matrices(), model.tensors(torch.float32)
    nothing = torch.zeros(FRAMES, model.shape_count + model.expression_count)

    def together() -> np.ndarray:
        with torch.no_grad():
            return reference_surface(
                tensors, nothing, matrices, torch.zeros(FRAMES, 3), True
            ).vertices.numpy()

    def alone() -> None:
        for pose in poses:
            evaluate(model, np.zeros(0), pose, np.zeros(3))

    scene = Scene(model, together())
    sent = paired_ratio(scene.send_vertices, scene.send_bones, REPEATS)
    posed = paired_ratio(together, alone, REPEATS)
    rows = [Row("sent: vertices / bones", sent, 1.0), Row("posed: 16 together / alone", posed, 1.0)]
    status = report("playback", rows, json_path=arguments.json, baseline=arguments.baseline)
    if CHROMIUM.exists():
        print(f"browser: {updates_per_second(scene):.1f} updates of the mesh a second")
    scene.server.stop()
    return status


if __name__ == "__main__":
    raise SystemExit(main())
