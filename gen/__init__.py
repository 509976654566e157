"""The factory: the Capture and its files, the reference BRDF, specs and the rendering of captures."""
