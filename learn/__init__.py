"""The networks that remove gloss. They enter through the registry of removers in `recon.registry`."""
