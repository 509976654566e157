"""Fixtures shared by all tests."""

from __future__ import annotations

import resource
import shutil
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gen.capture import Capture, Truth
from gen.parts import PARTS
from gen.parts import data_folder as data_folder_of_parts
from gen.substrate import shade


@pytest.fixture(scope="session", autouse=True)
def _interruptible() -> None:
    """A shell hands SIGINT down ignored to what it runs in the background; tests that interrupt would then wait in vain."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The reference photographs: DEGLOSS_DATA, by default ../shared/data beside the repository."""
    folder = data_folder_of_parts()
    if not folder.is_dir():
        pytest.skip(f"no reference data at {folder}; set DEGLOSS_DATA")
    return folder


pytest.register_assert_rewrite("tests.pages")


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A window of headless Chromium with the network cut. Debian's or Google's own: Playwright's download is not needed for one engine."""
    sync = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no Chromium here; install the package chromium")
    arguments = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=arguments)
        yield browser.new_context(offline=True, permissions=["clipboard-read", "clipboard-write"])
        browser.close()


@contextmanager
def full_disk(room: int) -> Iterator[None]:
    """No file may grow beyond so many bytes: what a full disk or a quota looks like to a program that writes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, handler)


Synthetic = Callable[..., Capture]


@pytest.fixture(scope="session")
def synthetic() -> Synthetic:
    """A function that makes a Capture of a sphere or cylinder in closed form, no renderer: see `synthetic_capture`."""
    return synthetic_capture


def synthetic_capture(
    shape: str = "sphere",
    size: int = 64,
    lights: np.ndarray | None = None,
    albedo: tuple[float, float, float] = (0.6, 0.3, 0.15),
    specular: float = 0.2,
    alpha: float = 0.2,
    layer: str = "combined",
) -> Capture:
    """Substrate sphere or cylinder (axis along y) from `gen.substrate`, orthographic, attached shadows only, with its truth.

    lights: (K, 3), by default one frontal and four at 35 degrees. layer: "combined", "diffuse" or "matte" as the pictures.
    """
    if lights is None:
        t = np.radians(35)
        lights = np.array(
            [
                [0, 0, 1],
                [np.sin(t), 0, np.cos(t)],
                [-np.sin(t), 0, np.cos(t)],
                [0, np.sin(t), np.cos(t)],
                [0, -np.sin(t), np.cos(t)],
            ]
        )
    radius = 0.45 * size
    y, x = np.mgrid[:size, :size].astype(float)
    x, y = x - (size - 1) / 2, (size - 1) / 2 - y
    if shape == "cylinder":
        mask = (abs(x) < radius) & (abs(y) < radius)
        n = np.stack([x / radius, 0 * x, np.sqrt(np.clip(1 - (x / radius) ** 2, 0, None))], -1)
    else:
        mask = x**2 + y**2 < radius**2
        n = np.stack([x / radius, y / radius, np.sqrt(np.clip(1 - (x**2 + y**2) / radius**2, 0, None))], -1)
    n = np.where(mask[..., None], n, 0)
    rd = np.asarray(albedo, float)
    parts = [shade(n[None], light, np.array([0.0, 0.0, 1.0]), rd, specular, alpha) for light in lights[:, None, None]]
    d, s, m = (np.concatenate([p[i] * np.ones(3) for p in parts]).astype(np.float32) * mask[None, :, :, None] for i in range(3))
    truth = Truth(
        normals=n.astype(np.float32),
        depth=np.where(mask, 1 - 0.001 * radius * n[..., 2], np.nan).astype(np.float32),
        albedo=(rd * mask[..., None]).astype(np.float32),
        gloss=(alpha * mask).astype(np.float32),
        diffuse=d,
        specular=s,
        matte=m,
    )
    images = {"combined": d + s, "diffuse": d, "matte": m}[layer]
    return Capture(images=images, lights=lights, mask=mask, truth=truth, source=f"synthetic {shape}")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip real renders, with the remedy, where Blender's module is not installed."""
    if find_spec("bpy") is None:
        skip = pytest.mark.skip(reason=PARTS["bpy"].line)
        for item in items:
            if item.get_closest_marker("render"):
                item.add_marker(skip)
