"""Antialiased renders: averages of exact samples, right at terminators and rims, where one render of many samples is not."""

from __future__ import annotations

import numpy as np
import pytest

from gen.substrate import shade

pytestmark = pytest.mark.render

N = 48
ALBEDO = np.array([0.5, 0.4, 0.3])


@pytest.fixture(scope="module")
def sphere(worker, job):
    """An antialiased sphere under light from the side, so that the terminator is seen, and its layers."""
    lights = [
        {"direction": [0.8, 0.48, 0.36], "intensity": [1.0, 1.0, 1.0]},
        {"direction": [-0.96, 0.0, -0.28], "intensity": [1.0] * 3},
    ]
    material = {"kind": "substrate", "diffuse": ALBEDO.tolist(), "specular": [0.2] * 3, "alpha": 0.25}
    camera = {"kind": "orthographic", "width": 60.0, "distance": 100.0}
    asked = job("sphere", "orthographic", size=(N, N), n=4, lights=lights, material=material, camera=camera)
    return asked, worker.render(asked)


def exact(asked, closed_form, fine: int = 20):
    """(diffuse, specular, matte) (3, K, N, N, 3) and coverage (N, N), averaged over fine x fine rays a pixel, in closed form."""
    total, share = 0.0, 0.0
    m = asked["material"]
    for i in range(fine):
        for j in range(fine):
            met, normal, _, view = closed_form(asked, (i + 0.5) / fine - 0.5, (j + 0.5) / fine - 0.5)
            parts = [
                np.stack(shade(normal, np.array(light["direction"]), view, ALBEDO, np.array(m["specular"]), m["alpha"]))
                for light in asked["lights"]
            ]
            total = total + np.stack(parts, 1) * met[..., None]
            share = share + met
    return total / fine**2, share / fine**2


def where(asked, closed_form):
    """Masks of the terminators' pixels (per light, well inside the outline) and of the outline's."""
    steps = [(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    met = np.stack([closed_form(asked, *step)[0] for step in steps])
    inner = met.all(0)
    terminators = []
    for light in asked["lights"]:
        lit = np.stack([(closed_form(asked, *step)[1] @ np.array(light["direction"])) > 0 for step in steps])
        terminators.append(inner & lit.any(0) & ~lit.all(0))
    return np.stack(terminators), met.any(0) & ~inner


RATIO = """
import json, sys
import numpy as np
from blender_scenes import layers, studio
from blender_scenes.shot import shoot

asked = json.loads(sys.argv[2])
scene = studio.empty_scene(2)
scene.cycles.samples = 64
scene.cycles.filter_width = 1.0
np.save(sys.argv[1], shoot(scene, {**asked, 'supersampling': 1})[0]['matte'])
"""


def test_twin_is_right_at_terminators_and_rims(sphere, closed_form, python, tmp_path) -> None:
    """Matte twin of 4 x 4 exact samples a pixel against the closed form averaged over 20 x 20.

    Measured, largest errors relative to the albedo, on a sphere 40 px wide: terminators 0.0004 and rims 0.08 (the outline's coverage is
    counted in sixteenths). Cycles' own 64-sample albedo * DiffDir, a ratio of averages: terminators 0.016, rims 0.93.
    """
    import json

    asked, layers = sphere
    (_, _, matte), _ = exact(asked, closed_form)
    terminators, rim = where(asked, closed_form)
    assert terminators.sum() > 40
    assert rim.sum() > 100
    ours = abs(layers["matte"] - matte).max(-1) / ALBEDO.max()
    python(RATIO, str(tmp_path / "ratio.npy"), json.dumps(asked))
    ratio = abs(np.load(tmp_path / "ratio.npy") - matte).max(-1) / ALBEDO.max()
    print("terminators", ours[terminators].max(), ratio[terminators].max(), "rims", ours[:, rim].max(), ratio[:, rim].max())
    assert ours[terminators].max() < 1e-3
    assert ours[:, rim].max() < 0.1
    assert ratio[terminators].max() > 5 * ours[terminators].max()
    assert ratio[:, rim].max() > 5 * ours[:, rim].max()


def test_all_layers_are_averages_over_the_pixel(sphere, closed_form) -> None:
    """Diffuse, specular and coverage against the closed form; inside the outline 4e-3 of the peak, on it sixteenths."""
    asked, layers = sphere
    parts, share = exact(asked, closed_form)
    _, rim = where(asked, closed_form)
    assert abs(layers["coverage"] - share).max() < 0.12
    assert (layers["coverage"] == share)[~rim].all()
    for name, part in zip(("diffuse", "specular", "matte"), parts, strict=True):
        error = abs(layers[name] - part).max(-1) / part.max()
        print(name, error[:, ~rim].max(), error.max())
        assert error[:, ~rim].max() < 4e-3, name
        assert error.max() < 0.12, name
    combined = layers["diffuse"] + layers["specular"]
    assert abs(layers["combined"] - combined).max() <= 1e-6 * max(1.0, combined.max())


def test_blocks_are_the_means_of_the_finer_picture(worker, sphere, job) -> None:
    """Supersampling 4 at N is exactly the 4 x 4 mean of supersampling 1 at 4 N."""
    asked, layers = sphere
    fine = worker.render({**asked, "resolution": [4 * N, 4 * N], "supersampling": 1})
    for name in ("combined", "diffuse", "specular", "matte"):
        blocks = fine[name].reshape(2, N, 4, N, 4, 3).astype(np.float64).mean((2, 4))
        np.testing.assert_allclose(layers[name], blocks, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(layers["coverage"], fine["coverage"].reshape(N, 4, N, 4).mean((1, 3)))
    depth = fine["depth"].reshape(N, 4, N, 4).transpose(0, 2, 1, 3).reshape(N, N, 16)
    hit = layers["coverage"] > 0
    np.testing.assert_allclose(layers["depth"][hit], np.nanmean(depth[hit], -1), rtol=1e-6)
    assert np.isnan(layers["depth"][~hit]).all()
    np.testing.assert_allclose(np.linalg.norm(layers["normal"][hit], axis=-1), 1, atol=1e-6)
