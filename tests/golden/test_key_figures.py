"""Key figures are what they were: rendered layers, removers and networks, repairs, solvers, integrators, and the whole."""

from __future__ import annotations

import pytest

from tests.golden.key_figures import KINDS, kept


@pytest.mark.parametrize("kind", [pytest.param(k, marks=pytest.mark.render) if k == "rendered layers" else k for k in KINDS])
def test_key_figures_stay(kind: str) -> None:
    """Every registered name has its figure, within the kind's tolerance. See `tests.golden.key_figures` where a change is meant."""
    compute, relative, absolute, reason = KINDS[kind]
    recorded = kept()[kind]
    assert (recorded["relative"], recorded["absolute"], recorded["reason"]) == (relative, absolute, reason)
    assert compute() == pytest.approx(recorded["figures"], rel=relative, abs=absolute)


def test_the_file_holds_nothing_else() -> None:
    assert list(kept()) == list(KINDS)
