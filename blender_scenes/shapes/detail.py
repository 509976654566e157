"""Surface detail on any shape: grooves, rings, scratches, dents, roughness, as true displacement whose normals are exact.

A detail is a function from a mesh and keyword parameters to a `Field`, a height at every point of space, and a `sample(rng)` for its
parameters, both entered in `DETAILS`. Parameters are declared as those of shapes are.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from blender_scenes.shapes import detail_grooves, detail_marks, detail_roughness
from blender_scenes.shapes.detail_fade import Fade, FadeAsking
from blender_scenes.shapes.detail_field import Asking, Field
from blender_scenes.shapes.detail_refinement import refined
from blender_scenes.shapes.detail_surface import Surface, bent, invariants, shape_operator, spread, surface_of
from blender_scenes.shapes.mesh import Mesh, Parameter
from blender_scenes.shapes.signature import checked, read_parameters
from blender_scenes.shapes.surface import Array


class Detail(NamedTuple):
    """field: a function from a mesh and parameters to a Field. sample: parameters drawn from a generator."""

    field: Callable[..., Field]
    sample: Callable[[np.random.Generator], dict[str, float]]


DETAILS: dict[str, Detail] = {
    "dents": Detail(detail_marks.dents, detail_marks.sample_dents),
    "grooves": Detail(detail_grooves.grooves, detail_grooves.sample_grooves),
    "rings": Detail(detail_grooves.rings, detail_grooves.sample_rings),
    "roughness": Detail(detail_roughness.roughness, detail_roughness.sample),
    "scratches": Detail(detail_marks.scratches, detail_marks.sample_scratches),
}
"""Kinds of detail by name."""

MAX_DETAILS = 8


@cache
def detail_parameters(kind: str) -> dict[str, Parameter]:
    """Each parameter of a kind of detail. Raises ValueError where the kind is unknown."""
    if kind not in DETAILS:
        raise ValueError(f"detail {kind}: unknown; there are {', '.join(DETAILS)}")
    return read_parameters(DETAILS[kind].field, f"detail {kind}")


def sample_detail(kind: str, rng: np.random.Generator) -> dict[str, Any]:
    """A detail of that kind with parameters drawn from `rng`, as `add_detail` takes it, for an object of some 40 mm."""
    detail_parameters(kind)
    return {"kind": kind, **DETAILS[kind].sample(rng)}


def describe_details() -> dict[str, str]:
    """The first line of each kind's docstring."""
    return {kind: (inspect.getdoc(detail.field) or "").split("\n")[0] for kind, detail in DETAILS.items()}


def checked_details(details: object) -> list[Mapping[str, Any]]:
    """`details`, which are what `add_detail` takes. ValueError, one line: wrong in kind, unknown, out of range, or too steep."""
    if not isinstance(details, list | tuple) or len(details) > MAX_DETAILS or not all(isinstance(d, Mapping) for d in details):
        raise ValueError(f"detail: must be a list of at most {MAX_DETAILS} objects like {{kind: grooves, pitch: 0.8}}")
    corner = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    _fields(Mesh(corner, np.array([[0, 1, 2]], np.int32), np.tile([0.0, 0, 1], (3, 1))), details)
    return list(details)


def _fields(mesh: Mesh, details: Sequence[Mapping[str, Any]]) -> list[Field]:
    """The field of each detail on a triangle mesh with normals."""
    found = []
    for detail in details:
        if "kind" not in detail:
            raise ValueError(f"detail: needs a kind; there are {', '.join(DETAILS)}")
        kind = str(detail["kind"])
        values = {str(key): value for key, value in detail.items() if key != "kind"}
        values = checked(values, detail_parameters(kind), f"detail {kind}")
        found.append(DETAILS[kind].field(mesh, **values))
    return found


def add_detail(mesh: Mesh, details: Sequence[Mapping[str, Any]]) -> Mesh:
    """The mesh with detail: refined where the detail asks for it, moved along its normals, with the normals of the moved surface.

    details: objects with "kind" (one of `DETAILS`) and parameters; their heights add up. Near sharp edges and narrow bends the detail
    fades out, so the surface stays closed where it was. A mesh without normals counts as flat faces. Where the smooth surface has unit
    normal n and shape operator S = dn, that of p + h n is along n - (I + h S)^-1 grad h, grad along the surface: exact, not
    interpolated, at every vertex. Raises ValueError, one line, for unknown kinds and parameters, values out of range, and detail
    so fine that the mesh would outgrow `detail_refinement.MAX_VERTICES`.
    """
    if not details:
        return mesh
    surface = surface_of(mesh)
    if mesh.normals is None or mesh.faces.shape[1] == 4:
        mesh = Mesh(surface.points[surface.place], surface.faces().astype(np.int32), surface.normals)
    given = _fields(mesh, details)
    fade = Fade(surface, sum(field.bound for field in given))
    asking = [
        Asking(f"{detail['kind']}: {field.finest}", field.spans, field.centres, field.reach)
        for detail, field in zip(details, given, strict=True)
    ]

    if len(fade.segments):
        asking.append(FadeAsking(asking[0].name, fade, lambda points: _height(given, points)[0]))
    return _displaced(refined(surface, asking), given, fade)


def _height(given: Sequence[Field], points: Array) -> tuple[Array, Array]:
    """The sum (N,) of the heights and its gradient (N, 3)."""
    height, gradient = np.zeros(len(points)), np.zeros((len(points), 3))
    for field in given:
        value, slope = field.height(points)
        height += value
        gradient += slope
    return height, gradient


def _displaced(surface: Surface, given: Sequence[Field], fade: Fade) -> Mesh:
    height, gradient = _height(given, surface.points)
    used = np.flatnonzero((height != 0) | (gradient != 0).any(axis=1))
    weight, slope = fade.weight(surface.points[used])
    gradient[used] = weight[:, None] * gradient[used] + height[used, None] * slope
    height[used] *= weight
    # Copies of a point move together, along their mean normal: where they differ by more than a trace, the weight is 0.
    mean = spread(surface.normals, surface.place, len(surface.points))
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    points = surface.points + height[:, None] * mean
    n, h, g = surface.normals, height[surface.place][:, None], gradient[surface.place]
    g = g - (g * n).sum(axis=1, keepdims=True) * n
    bend = shape_operator(surface)
    total, product = (value[:, None] for value in invariants(bend))
    # (I + hS)^-1 in the tangent plane, by Cayley and Hamilton.
    along = ((1 + h * total) * g - h * bent(bend, g)) / np.where(h == 0, 1.0, 1 + h * total + h * h * product)
    return Mesh(points[surface.place], surface.faces().astype(np.int32), n - along)
