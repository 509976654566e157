"""Photometric stereo: normals and albedo from K samples a pixel, by the names of `recon.registry.NORMALS`."""
