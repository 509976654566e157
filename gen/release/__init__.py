"""Releases: a rendered set as files that a stranger can verify, load and cite. The parts of the folder: `gen.release.layout`."""
