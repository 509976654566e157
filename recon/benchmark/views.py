"""Benchmarks of views: objects seen from several sides, each measured to one mesh by each combination of methods.

An object is a folder of views (see `recon.multiview.views`), found on disk or rendered into the benchmark's folder. Its mesh is compared
with the true surface that the views' own depths say.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gen.errors import InputError, MissingPart
from gen.files import real
from gen.sets.set_folder import is_set_folder
from gen.sets.set_spec import evenly
from recon.benchmark.cells import PART_MISSING, SIDE, Row
from recon.benchmark.spec import Combination, Source
from recon.benchmark.units import rendered_set
from recon.inspection.nominal import Surface
from recon.inspection.pose import Pose
from recon.inspection.view import View as Camera
from recon.inspection.view import seen
from recon.metrics import normal_bytes
from recon.multiview.compare import compare, true_surface
from recon.multiview.measure import measure_views
from recon.multiview.views import CAMERAS, View, read_views
from recon.page_parts import Window
from recon.pictures import tone, white_of
from recon.reconstruct import Settings

if TYPE_CHECKING:
    import trimesh

SHOWN = 2
"""Views of each object from which its meshes are drawn for the page: the first and the one half way round."""


@dataclass(frozen=True)
class ViewsUnit:
    """One object under one combination of methods. name: the object's. path: of the folder of its views. views: their number."""

    name: str
    path: str
    views: int
    methods: Combination

    @property
    def key(self) -> str:
        """A file name of its own."""
        text = f"{self.name}\n{self.path}"
        return "-".join([hashlib.sha256(text.encode()).hexdigest()[:12], *self.methods[:3]])


def objects(sources: Iterable[Source], folder: Path, rendered: Path, workers: int = 1) -> list[tuple[str, Path]]:
    """(name, path) of every object of the sources, in order, each once.

    folder: where relative paths start. rendered: where sets are rendered, or were by an earlier run, by so many workers. Raises InputError
    where a path does not exist or two objects have one name, and as rendering does.
    """
    found: dict[Path, tuple[str, Path]] = {}
    for source in sources:
        here = _under(folder / source.path) if source.path is not None else [rendered_set(str(source.set), rendered, workers)]
        for i in evenly(len(here), source.limit):
            found.setdefault(real(here[i]), (real(here[i]).name, here[i]))
    names = [name for name, _ in found.values()]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"views: two objects are named {twice}; the tables could not tell them apart")
    return list(found.values())


def _under(path: Path) -> list[Path]:
    """A folder of views, or each folder in a folder."""
    if not path.is_dir():
        raise InputError(f"{path}: is no folder of views")
    if not (path / CAMERAS).is_file() and not is_set_folder(path):
        inside = sorted(entry for entry in path.iterdir() if entry.is_dir() and not entry.name.startswith("."))
        if inside:
            return inside
    return [path]


def views_units(combinations: Sequence[Combination], where: Iterable[tuple[str, Path]]) -> list[ViewsUnit]:
    """Every object under every combination. Raises InputError where its views cannot be read or do not know their true depth."""
    found: list[ViewsUnit] = []
    for name, path in where:
        try:
            views, _ = read_views(path)
        except InputError as error:
            raise InputError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
        bare = next((view.name for view in views if view.capture.truth.depth is None), None)
        if bare is not None:
            raise InputError(f"{path}: view {bare} has no true depth to measure against")
        found += [ViewsUnit(name, str(path), len(views), methods) for methods in combinations]
    return found


def measure_views_unit(unit: ViewsUnit) -> tuple[list[Row], dict[str, NDArray[Any]]]:
    """The one row of a unit, and maps of its mesh (see `maps_of`), none where it failed.

    The row holds "object", "views", the methods' names, and either "failed", a sentence, or "triangles", "seconds" of each step and the
    figures of `recon.multiview.compare.compare` within a voxel, as `recon.multiview.measure.compare_rows` gives them.
    """
    gloss, repair, normals, height = unit.methods
    row: Row = {"object": unit.name, "views": unit.views}
    row |= {"gloss": gloss, "repair": repair, "normals_by": normals, "height_by": height}
    views, ball = read_views(Path(unit.path))
    truth = true_surface(views)
    assert truth is not None  # `views_units` has looked
    try:
        model = measure_views(views, ball, Settings(gloss, repair, normals, height))
        row |= {"triangles": len(model.mesh.faces), **compare(model.mesh, truth, model.voxel), "seconds": dict(model.seconds)}
    except InputError as error:
        row["failed"] = str(error)
        row |= {PART_MISSING: True} if isinstance(error, MissingPart) else {}
        return [row], {}
    return [row], maps_of(views, model.mesh)


def maps_of(views: Sequence[View], mesh: trimesh.Trimesh) -> dict[str, NDArray[Any]]:
    """A mesh as `SHOWN` of the views see it, and what they truly show, cut to the object and thinned to `SIDE` pixels.

    views: their names, at most `SHOWN`; and by number, "picture0" (h, w, 3) the brightest picture; "true0", "depth0" (h, w) mm along the
    optical axis, NaN where there is none, of the truth and the mesh; "true normal0", where known, and "normal0" (h, w, 3) bytes; "window0"
    the first row, the end and the step of the map's rows, then of its columns; "step0" the mm between its neighbours at the object.
    """
    chosen = [views[i] for i in evenly(len(views) + 1, SHOWN + 1)[:-1]]
    maps: dict[str, NDArray[Any]] = {"views": np.array([view.name for view in chosen], np.str_)}
    for v, view in enumerate(chosen):
        capture = view.capture
        window = Window.around(capture.mask, SIDE)
        brightest = capture.images[int(np.argmax(capture.images[:, capture.mask].mean(axis=(1, 2))))]
        depth, normal = drawn(mesh, view)
        assert capture.truth.depth is not None
        assert capture.scale.metres_per_pixel is not None  # of every view that `read_views` returns
        maps |= {
            f"picture{v}": window.cut(tone(brightest, white_of(brightest, capture.mask))),
            f"true{v}": window.cut(np.where(capture.mask, 1000 * capture.truth.depth, np.nan).astype(np.float32)),
            f"depth{v}": window.cut(depth),
            f"normal{v}": window.cut(normal_bytes(normal)),
            f"window{v}": np.array([(s.start, s.stop, s.step) for s in (window.rows, window.columns)]),
            f"step{v}": np.array(1000 * capture.scale.metres_per_pixel * window.rows.step),
        }
        if capture.truth.normals is not None:
            maps[f"true normal{v}"] = window.cut(normal_bytes(capture.truth.normals))
    return maps


def drawn(mesh: trimesh.Trimesh, view: View) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Depth (H, W) in mm along the optical axis, NaN where there is none, and normal (H, W, 3), camera frame, of a mesh in a view.

    mesh: object's frame, mm. Only its outer side is drawn: what is seen through an opening stays empty.
    """
    vertices = np.asarray(mesh.vertices, np.float64)
    outward = np.einsum("fk,fk->f", mesh.face_normals, view.centre - mesh.triangles_center) > 0
    surface = Surface(vertices, np.asarray(mesh.faces, np.int64)[outward], np.asarray(mesh.vertex_normals, np.float64), "", "mm")
    K = view.K
    camera = Camera(view.capture.size, (float(K[0, 2]), float(K[1, 2])), 1.0, (float(K[0, 0]), float(K[1, 1])))
    found = seen(surface, Pose(view.rotation, view.pose[:3, 3]), camera)
    depth = np.where(found.inside, -found.points[..., 2], np.nan)
    return depth.astype(np.float32), found.normal.astype(np.float32)
