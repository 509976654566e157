"""The methods of gloss removal that are learned: one module each; see `learn.method`."""
