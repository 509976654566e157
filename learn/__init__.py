"""The networks that remove gloss. They enter through the registry of removers in `recon.registry`."""

from pathlib import Path as _Path

import recon as _recon

if _Path(_recon.__file__ or "").resolve().parent.parent != _Path(__file__).resolve().parent.parent:
    raise ImportError(
        f"{_recon.__file__ or 'recon'} is another project's package, called like one of degloss: it comes first on Python's path",
        name="recon",
    )
