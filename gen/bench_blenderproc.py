"""The same stack by BlenderProc, for `gen.bench`: run by a Python that has BlenderProc and bpy.

python bench_blenderproc.py OUT_FOLDER STACKS      prints {"start": seconds, "stacks": [seconds, ...]} as its last line

A stack is ten renders of 256x256 at 4 samples: a cylinder under five suns, once glossy and once matte, each with its HDF5 file, as
BlenderProc has neither a gloss-free twin nor a split of the radiance, with normals and depth.
"""

import json
import os
import sys
import time
from typing import Any

os.environ.setdefault("USE_EXTERNAL_BPY_MODULE", "1")


def main(folder: str, count: int) -> None:
    """Render `count` stacks into `folder`."""
    began = time.perf_counter()
    import blenderproc  # type: ignore[import-not-found, unused-ignore]
    import numpy as np

    tool: Any = blenderproc
    tool.init()
    item = tool.object.create_primitive("CYLINDER", radius=0.022, depth=0.05, vertices=256)
    materials = []
    for name, roughness, specular in (("glossy", 0.3, 0.5), ("matte", 1.0, 0.0)):
        material = tool.material.create(name)
        material.set_principled_shader_value("Base Color", [0.9, 0.36, 0.18, 1.0])
        material.set_principled_shader_value("Roughness", roughness)
        material.set_principled_shader_value("Specular IOR Level", specular)
        materials.append(material)
    item.add_material(materials[0])
    item.set_rotation_euler([np.pi / 2, 0, 0])
    light = tool.types.Light()
    light.set_type("SUN")
    light.set_energy(3.0)
    # The frame is 60 mm wide where the cylinder stands, as in the stack that it is compared with.
    tool.camera.set_intrinsics_from_K_matrix(
        np.array([[256 * 1.0 / 0.06, 0, 127.5], [0, 256 * 1.0 / 0.06, 127.5], [0, 0, 1]]), 256, 256
    )
    pose = np.eye(4)
    pose[2, 3] = 1.0
    tool.renderer.set_max_amount_of_samples(4)
    tool.renderer.set_noise_threshold(0)
    tool.renderer.set_denoiser(None)
    tool.renderer.set_output_format("OPEN_EXR")
    tool.renderer.enable_normals_output()
    tool.renderer.enable_depth_output(activate_antialiasing=False)
    seconds = []
    started = time.perf_counter() - began
    for _ in range(count):
        began = time.perf_counter()
        for tilt in [(0, 0), (0, 0.61), (0, -0.61), (0.61, 0), (-0.61, 0)]:
            light.set_rotation_euler([*tilt, 0])
            for material in materials:
                item.set_material(0, material)
                tool.utility.reset_keyframes()
                tool.camera.add_camera_pose(pose)
                data = tool.renderer.render()
                tool.writer.write_hdf5(folder, data, append_to_existing_output=True)
        seconds.append(time.perf_counter() - began)
    print("\n" + json.dumps({"start": started, "stacks": seconds}))


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
