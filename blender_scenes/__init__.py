"""The studio: one shape, one material, one camera, K lights, rendered in headless Cycles; layers out.

The only code of the project that imports bpy. It needs bpy (or an installed Blender) and numpy, nothing else. It takes a job with
every value resolved (see `blender_scenes.job`) and hands back arrays; it knows no data set, no network and no split.
"""
