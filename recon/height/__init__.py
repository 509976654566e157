"""Integration: from normals to height. The names are in `recon.registry.HEIGHT`."""
