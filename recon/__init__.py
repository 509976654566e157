"""The measurement: gloss removal, repair, photometric stereo, integration, mesh, comparison and report."""
