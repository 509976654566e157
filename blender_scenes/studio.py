"""The empty studio: bpy itself, a scene set for exact renders, a mesh put in and taken out again."""

from __future__ import annotations

from typing import Any

import numpy as np

from blender_scenes.errors import JobError, MissingBlender
from blender_scenes.shapes import Mesh
from blender_scenes.versions import check_version

LIBRARIES = "libx11-6 libxrender1 libxfixes3 libxi6 libxkbcommon0 libsm6 libice6 libxext6 libgl1"
"""The system libraries (Debian's names) that the bpy wheel needs beside what a bare system has."""

REMEDY = f"pip install 'bpy>=4.5,<5.1' (Python 3.11) and, on Debian or Ubuntu, apt-get install -y {LIBRARIES}"


def blender() -> Any:
    """The module bpy. Raises MissingBlender, one line with the remedy, where it or a system library is missing, or where it is too old."""
    try:
        import bpy
    except (ImportError, OSError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise MissingBlender(f"Blender cannot start ({reason}): {REMEDY}") from error
    check_version(bpy.app.version)
    return bpy


def empty_scene(threads: int = 0, device: str = "cpu") -> Any:
    """A new scene with nothing in it, set for one exact sample a pixel, and its view layer's passes switched on. Returns the scene.

    threads: of Cycles, 0 for all cores. device: "cpu", "gpu", or "auto" for a GPU where Cycles finds one; `scene.cycles.device` then says
    which it is. Everything that was open in Blender before is discarded. Raises JobError where a GPU is asked for and there is none.

    One sample at the pixel's centre (further ones lie within a filter of the least width, 0.01 px), direct light only: with a sun of
    angle 0 such a render holds no noise, and the passes of a pixel are functions of one surface point.
    """
    bpy = blender()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.world = None
    render = scene.render
    render.threads_mode = "FIXED" if threads else "AUTO"
    if threads:
        render.threads = threads
    render.film_transparent = True
    render.filter_size = 0.01
    render.use_persistent_data = True
    render.use_compositing = False
    render.use_sequencer = False
    render.use_motion_blur = False
    render.resolution_percentage = 100
    render.dither_intensity = 0.0
    cycles = scene.cycles
    cycles.device = "CPU" if device == "cpu" or not _use_gpu(required=device == "gpu") else "GPU"
    cycles.samples = 1
    cycles.use_adaptive_sampling = False
    cycles.use_denoising = False
    # Not BOX: Blender makes that one a pixel wide whatever the width says. The first sample lies at the filter's middle.
    cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    cycles.filter_width = 0.01
    cycles.film_exposure = 1.0
    cycles.seed = 0
    cycles.use_auto_tile = False
    cycles.max_bounces = 0
    cycles.sample_clamp_direct = 0.0
    cycles.sample_clamp_indirect = 0.0
    # Cycles would drop weak contributions at random, and blur the lobe of glossy surfaces.
    cycles.light_sampling_threshold = 0.0
    cycles.blur_glossy = 0.0
    scene.view_layers[0].name = "View"
    return scene


GPU_KINDS = ("OPTIX", "CUDA", "HIP", "ONEAPI", "METAL")
"""What Cycles can compute with beside the CPU, in the order in which they are tried."""


def _use_gpu(required: bool) -> bool:
    """Switch on the GPUs of the first kind that Cycles finds. Returns whether there is one."""
    addon = blender().context.preferences.addons.get("cycles")
    preferences: Any = None if addon is None else addon.preferences
    for kind in GPU_KINDS if preferences is not None else ():
        try:
            preferences.compute_device_type = kind
            devices = [item for item in preferences.get_devices_for_type(kind) if item.type == kind]
        except (TypeError, ValueError):  # this Blender was built without that kind
            continue
        if devices:
            for item in preferences.devices:
                item.use = item.type == kind
            return True
    if required:
        raise JobError("Cycles finds no GPU that it can render on; leave the device to auto, or say cpu")
    return False


def sample_by(scene: Any, samples: int, bounces: int, seed: int) -> None:
    """Set how many samples are drawn at a point, how often light may pass from surface to surface, and the seed of both."""
    cycles = scene.cycles
    cycles.samples, cycles.seed = samples, seed
    # Every pixel draws the same directions: what error there is is smooth (light from that many directions), where noise would be in its
    # place, eight times as strong from pixel to pixel at 32 samples under a panorama.
    cycles.sampling_pattern = "TABULATED_SOBOL"
    cycles.scrambling_distance = 0.0
    # The tree of lights picks among many; where one sample meets one light it costs a tenth of the render and decides nothing.
    cycles.use_light_tree = samples > 1
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = bounces


def put_mesh(scene: Any, mesh: Mesh) -> Any:
    """A mesh, given in world coordinates, as an object of the scene, without a material. Returns the object; `take_out` removes it."""
    bpy = blender()
    data = bpy.data.meshes.new("shape")
    corners = mesh.faces.shape[1]
    data.vertices.add(len(mesh.vertices))
    data.vertices.foreach_set("co", mesh.vertices.astype(np.float32).ravel())
    data.loops.add(mesh.faces.size)
    data.loops.foreach_set("vertex_index", mesh.faces.ravel())
    data.polygons.add(len(mesh.faces))
    data.polygons.foreach_set("loop_start", np.arange(0, mesh.faces.size, corners, dtype=np.int32))
    data.update(calc_edges=True)
    if mesh.normals is None:
        data.shade_flat()
    else:
        # Free normals: taken as they stand, and unlike Blender's own smooth shading the same bits in every run.
        attribute = data.attributes.new("custom_normal", "FLOAT_VECTOR", "POINT")
        attribute.data.foreach_set("vector", mesh.normals.astype(np.float32).ravel())
    item = bpy.data.objects.new("shape", data)
    scene.collection.objects.link(item)
    # Where the light grazes, rays to the light start from the smooth surface that the normals describe, not from the facet under it:
    # otherwise facets turned away from the light would be in shadow up to half a facet's angle before the terminator.
    cycles = getattr(item, "cycles", None)
    if hasattr(item, "shadow_terminator_geometry_offset"):
        item.shadow_terminator_geometry_offset = TERMINATOR
        item.shadow_terminator_shading_offset = 0.0
    elif cycles is not None and hasattr(cycles, "shadow_terminator_geometry_offset"):
        cycles.shadow_terminator_geometry_offset = TERMINATOR
        cycles.shadow_terminator_offset = 0.0
    return item


TERMINATOR = 0.1
"""The cosine of the light's angle under which shadow rays start from the smooth surface."""


def take_out(item: Any) -> None:
    """Remove an object with its data and its materials, so that memory stays level over many jobs."""
    bpy = blender()
    data = item.data
    materials = list(getattr(data, "materials", []))
    bpy.data.objects.remove(item, do_unlink=True)
    for collection in (bpy.data.meshes, bpy.data.cameras, bpy.data.lights):
        if data is not None and data.name in collection and collection[data.name] == data:
            collection.remove(data, do_unlink=True)
            break
    for material in materials:
        remove_material(material)


def remove_material(material: Any) -> None:
    """Remove a material of `blender_scenes.materials`."""
    blender().data.materials.remove(material, do_unlink=True)
