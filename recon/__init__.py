"""The measurement: gloss removal, repair, photometric stereo, integration, mesh, comparison and report."""

from pathlib import Path as _Path

import gen as _gen

if _Path(_gen.__file__ or "").resolve().parent.parent != _Path(__file__).resolve().parent.parent:
    raise ImportError(
        f"{_gen.__file__ or 'gen'} is another project's package, called like one of degloss: it comes first on Python's path",
        name="gen",
    )
