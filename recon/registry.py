"""Everything that has a name: gloss removers, repairs, normal solvers and integrators.

The tables hold "module:function" and import when the name is used, so a remover may need torch and the rest does not.
To add a method: write a function of the protocol below, give its docstring a first line and a source, and enter it here.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from gen.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from gen.capture import Capture, Scale

    Floats = NDArray[np.float32]
    Bools = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Layers:
    """What a gloss remover hands back, each (K, H, W, 3) float32 radiance in the capture's exposure.

    diffuse, specular: the two parts of the glossy surface; their sum is the input wherever it was valid.
    matte: the gloss-free twin (Lambertian), where the method predicts it. confidence: (K, H, W) in [0, 1], where it gives one.
    doubt: (H, W) in [0, 1], how far the method was not believed at a pixel, where it says so. kept: (H, W) in [0, 1], how far matte is the
    picture as it was, for that reason or because nothing much would change.
    """

    diffuse: Floats
    specular: Floats
    matte: Floats | None = None
    confidence: Floats | None = None
    doubt: Floats | None = None
    kept: Floats | None = None


@dataclass(frozen=True, eq=False)
class Repaired:
    """Pictures after repair: images (K, H, W, 3) and a weight for every sample, (K, H, W) in [0, 1] (0: leave it out)."""

    images: Floats
    weights: Floats


@dataclass(frozen=True, eq=False)
class Normals:
    """What a photometric-stereo solver hands back.

    normal: (H, W, 3) float32 unit, zero where not measurable or outside the mask. albedo: (H, W, 3) float32.
    uncertainty: (H, W) float32, one standard deviation of the normal's angle in degrees, NaN where unknown.
    measurable: (H, W) bool.
    """

    normal: Floats
    albedo: Floats
    uncertainty: Floats
    measurable: Bools


@dataclass(frozen=True, eq=False)
class Height:
    """What an integrator hands back.

    height: (H, W) float32 along +z in `unit` ("m" or "px"), mean zero over the mask, NaN outside.
    points: (H, W, 3) float32 in the same unit, camera frame, the surface itself (perspective views bend the pixel grid), NaN
    outside.
    """

    height: Floats
    points: Floats
    unit: str


class Remover(Protocol):
    """Capture -> Layers."""

    def __call__(self, capture: Capture) -> Layers: ...


class Repair(Protocol):
    """(images (K, H, W, 3), defects (K, H, W) bool, capture) -> Repaired."""

    def __call__(self, images: Floats, defects: Bools, capture: Capture) -> Repaired: ...


class Solver(Protocol):
    """(reflectance (K, H, W, 3), lights (K, 3), mask (H, W), weights (K, H, W)) -> Normals."""

    def __call__(self, reflectance: Floats, lights: NDArray[np.float64], mask: Bools, weights: Floats) -> Normals: ...


class Integrator(Protocol):
    """(normal (H, W, 3), mask (H, W), scale) -> Height."""

    def __call__(self, normal: Floats, mask: Bools, scale: Scale) -> Height: ...


Method = TypeVar("Method")


class Registry(Mapping[str, str], Generic[Method]):
    """Names of one kind of method, each with its "module:function". An unknown name is an InputError that lists the known ones."""

    def __init__(self, kind: str, option: str, table: Mapping[str, str]) -> None:
        self.kind = kind
        self.option = option
        self._table = dict(table)

    def __getitem__(self, name: str) -> str:
        if name not in self._table:
            raise InputError(f"{self.option} {name}: unknown {self.kind}; there are {', '.join(self._table)}")
        return self._table[name]

    def __contains__(self, name: object) -> bool:
        return name in self._table

    def __iter__(self) -> Iterator[str]:
        return iter(self._table)

    def __len__(self) -> int:
        return len(self._table)

    def load(self, name: str) -> Method:
        """The function of that name. Raises InputError where it is unknown."""
        module, function = self[name].split(":")
        found: Method = getattr(import_module(module), function)
        return found

    def describe(self) -> dict[str, tuple[str, str]]:
        """The first line of each method's docstring, and its source ("" where it has none)."""
        return {name: _described(inspect.getdoc(self.load(name)) or "") for name in self}


def _described(text: str) -> tuple[str, str]:
    source = text.partition("Source:")[2].split("\n\n")[0]
    return text.split("\n")[0], " ".join(source.split())


GLOSS: Registry[Remover] = Registry(
    "gloss remover",
    "--gloss",
    {
        "none": "recon.gloss.identity:none",
        "bilateral": "recon.gloss.bilateral:bilateral",
        "chromaticity": "recon.gloss.chromaticity:chromaticity",
        "low-rank": "recon.gloss.low_rank:low_rank",
        "explain": "recon.gloss.explain:explain",
        "lime": "learn.removers:lime",
        "specular": "learn.removers:specular",
        "diffuse": "learn.removers:diffuse",
        "group": "learn.removers:group",
        "true-diffuse": "recon.gloss.identity:true_diffuse",
        "true-matte": "recon.gloss.identity:true_matte",
    },
)
REPAIR: Registry[Repair] = Registry(
    "repair",
    "--inpaint",
    {
        "none": "recon.repair.samples:none",
        "telea": "recon.repair.inpainting:telea",
        "navier-stokes": "recon.repair.inpainting:navier_stokes",
        "biharmonic": "recon.repair.inpainting:biharmonic",
        "stack": "recon.repair.stack:stack",
        "drop": "recon.repair.samples:drop",
    },
)
NORMALS: Registry[Solver] = Registry(
    "photometric-stereo solver",
    "--normals",
    {
        "least-squares": "recon.normals.least_squares:least_squares",
        "three-light": "recon.normals.three_light:three_light",
        "l1": "recon.normals.l1:l1",
        "sparse-bayesian": "recon.normals.sparse_bayesian:sparse_bayesian",
        "thresholded-sparse-bayesian": "recon.normals.sparse_bayesian:thresholded_sparse_bayesian",
        "rank-minimisation": "recon.normals.rank_minimisation:rank_minimisation",
        "position-threshold": "recon.normals.position_threshold:position_threshold",
        "coat": "recon.normals.coat:coat",
        "semi-calibrated": "recon.normals.semi_calibrated:semi_calibrated",
        "explain": "recon.normals.explain:explain",
    },
)
HEIGHT: Registry[Integrator] = Registry(
    "integrator",
    "--height",
    {
        "quadratic": "recon.height.quadratic:quadratic",
        "dct": "recon.height.poisson:dct",
        "bilateral": "recon.height.bilateral:bilateral",
        "adaptive": "recon.height.adaptive:adaptive",
    },
)


FEWEST_FOR_GROUP = 3
"""Pictures from which on "group" is the default, and its layers are checked: fewer give no normals to check them by."""


def default_methods(pictures: int, gloss: str | None = None, repair: str | None = None) -> tuple[str, str]:
    """The remover and the repair of a measurement, each by default where it is None.

    pictures: how many the capture has. The remover is "group" from `FEWEST_FOR_GROUP` on where torch is installed, else "chromaticity". The
    repair is "none" after "group", whose confidence already says what to distrust, else "telea". Names that are given are not checked.
    """
    from gen.parts import PARTS

    if gloss is None:
        gloss = "group" if pictures >= FEWEST_FOR_GROUP and PARTS["torch"].look().state == "ok" else "chromaticity"
    return gloss, repair or ("none" if gloss == "group" else "telea")
