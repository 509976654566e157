"""The lights of photographs, from what capture.yaml says: directions, places, a file, or balls to be measured."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gen.capture import grey
from gen.errors import InputError
from gen.files import read_lines
from gen.formats.tables import check_count, check_lengths, read_directions, read_named_directions
from gen.images import read_mask
from gen.photos.balls import BallLights, matte_ball, mirror_ball
from gen.photos.darkroom import Photographs, develop_stack
from gen.photos.intensities import Vectors, estimate_intensities
from gen.photos.listing import existing, named_files, photographs_of
from gen.photos.near import light_places, refined_places, require_places
from gen.photos.outline import Circle, circle_points, contour, find_circle, sphere_of
from gen.photos.spec import NAME, BallSpec, PhotoSpec
from gen.photos.view import Doubles, Sphere


@dataclass(frozen=True, eq=False)
class Lights:
    """directions: (K, 3), of any length. positions: (K, 3) mm or None. strengths: (K, 3) relative, or None where they were not measured.

    record: how they came about, for the provenance.
    """

    directions: Doubles
    positions: Doubles | None = None
    strengths: Doubles | None = None
    record: dict[str, Any] = field(default_factory=dict)


def lights_of(folder: Path, spec: PhotoSpec, photographs: Photographs) -> Lights:
    """The lights of the photographs. Raises InputError where there are none, not one a picture, or a ball does not show them."""
    where, count = folder / NAME, len(photographs.images)
    given = spec.lights
    if given is None:
        raise InputError(f"{where}: lights: is missing; give directions, positions_mm, a file, or balls to measure them on")
    if given.directions is not None:
        _one_each(len(given.directions), count, f"{where}: lights.directions")
        return Lights(np.array(given.directions), record={"lights": "given"})
    if given.positions_mm is not None:
        _one_each(len(given.positions_mm), count, f"{where}: lights.positions_mm")
        places = np.array(given.positions_mm)
        return Lights(places, places, record={"lights": "given places"})
    if given.file is not None:
        return Lights(_from_file(folder, given.file, photographs.names), record={"lights": given.file})
    assert given.balls is not None
    return _from_balls(folder, spec, given.balls, given.near, photographs)


def strengths_of(folder: Path, spec: PhotoSpec, photographs: Photographs, lights: Lights) -> tuple[Doubles, str, float | None]:
    """(intensities (K, 3), how they came about in words, the estimate's residual or None).

    Left out in the spec, they are those that a matte ball showed, or are estimated from the object with four or more lights.
    Raises InputError where as many as pictures are needed, or an estimate that was asked for is not possible.
    """
    count = len(photographs.images)
    if isinstance(spec.intensities, tuple):
        _one_each(len(spec.intensities), count, f"{folder / NAME}: intensities")
        return np.array(spec.intensities), "given", None
    if spec.intensities == "equal":
        return np.ones((count, 3)), "equal, as said", None
    if spec.intensities is None and lights.strengths is not None:
        return lights.strengths, "measured on the matte ball", None
    if spec.intensities is None and count < 4:
        return np.ones((count, 3)), "equal, because fewer than four lights cannot be estimated", None
    view = photographs.view
    vectors: Vectors = lights.directions / np.linalg.norm(lights.directions, axis=1, keepdims=True)
    if lights.positions is not None and view.metric:
        places = lights.positions

        def near(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Doubles:
            toward = places[:, None] - view.plane_points(columns, rows)
            vectors: Doubles = (
                toward * (places**2).sum(axis=1)[:, None, None] / np.linalg.norm(toward, axis=-1, keepdims=True) ** 3
            )
            return vectors

        vectors = near
    try:
        found, residual = estimate_intensities(photographs.images, vectors, photographs.mask, photographs.faults, str(folder))
    except InputError as error:
        if spec.intensities == "estimate":
            raise
        return np.ones((count, 3)), f"equal, because they could not be estimated ({str(error).removeprefix(f'{folder}: ')})", None
    return found, "estimated from the object", residual


def _from_file(folder: Path, name: str, names: tuple[str, ...]) -> Doubles:
    path = existing(folder, name, "lights.file")
    lines = [line for _, line in read_lines(path, "light directions") if not line.startswith("#")]
    words = lines[-1].split("#")[0].replace(",", " ").replace(";", " ").split() if lines else []
    if words and not _numbers(words):
        listed, directions = read_named_directions(path, "lights, file x y z a line")
        rows = {one.replace("\\", "/"): row for one, row in zip(listed, directions, strict=True)}
        missing = [one for one in names if one not in rows and Path(one).name not in rows]
        if missing:
            raise InputError(f"{path}: has no light for {missing[0]}; there must be one a picture")
        return np.array([rows[one] if one in rows else rows[Path(one).name] for one in names])
    directions = read_directions(path)
    check_count(path, len(directions), len(names), "light directions")
    check_lengths(path, directions)
    return directions


def _from_balls(
    folder: Path, spec: PhotoSpec, balls: tuple[BallSpec, ...], near: bool | None, photographs: Photographs
) -> Lights:
    view = photographs.view
    if near and (len(balls) < 2 or not view.metric):
        raise InputError(f"{folder / NAME}: lights.near: needs two balls and the scale: mm_per_pixel, or camera with distance_mm")
    seen: list[BallLights] = []
    spheres: list[Sphere] = []
    stacks: list[tuple[NDArray[np.float32], NDArray[np.uint8]]] = []
    for n, ball in enumerate(balls):
        key = f"{folder / NAME}: lights.balls[{n}]"
        images, faults = _ball_pictures(folder, spec, ball, n, photographs)
        sphere = sphere_of(_outline(folder, ball, images, photographs, key), view, key, ball.diameter_mm, ball.height_mm)
        if ball.kind == "chrome":
            seen.append(mirror_ball(grey(images), sphere, view, key, photographs.names))
        else:
            seen.append(matte_ball(images, faults, sphere, view, key, photographs.names))
        spheres.append(sphere)
        stacks.append((images, faults))
    directions = np.mean([found.directions for found in seen], axis=0)
    apart = [np.degrees(np.arccos(np.clip((found.directions * _unit(directions)).sum(1), -1, 1))) for found in seen]
    record: dict[str, Any] = {
        "lights": "measured on " + " and ".join(f"a {ball.kind} ball" for ball in balls),
        "balls": [
            {
                "kind": ball.kind,
                "outline_share": sphere.reliable,
                "residual": found.residuals.tolist(),
                "off_the_mean_degrees": off.tolist(),
            }
            for ball, sphere, found, off in zip(balls, spheres, seen, apart, strict=True)
        ],
    }
    matte = [found.strengths for found in seen if found.strengths is not None]
    strengths = np.mean([part / part.mean(axis=0) for part in matte], axis=0) if matte else None
    if near is False or len(balls) < 2 or not view.metric:
        return Lights(directions, None, strengths, record)
    places, misses = light_places(seen)
    if near:
        require_places(places, f"{folder / NAME}: lights", photographs.names)
    if not np.isfinite(places).all():
        return Lights(
            directions, None, strengths, {**record, "near": "no: the rays to a light do not meet, so all are taken as distant"}
        )
    if all(ball.kind == "matte" for ball in balls):
        places = refined_places(places, [images for images, _ in stacks], [faults for _, faults in stacks], spheres, view)
    record["rays_miss_mm"] = misses.tolist()
    return Lights(places, places, None, record)


def _ball_pictures(
    folder: Path, spec: PhotoSpec, ball: BallSpec, n: int, photographs: Photographs
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    if ball.images is None:
        return photographs.images, photographs.faults
    key = f"lights.balls[{n}].images"
    groups = photographs_of(folder, ball.images, named_files(folder, spec), key)
    _one_each(len(groups), len(photographs.images), f"{folder / NAME}: {key}")
    times = [one.exposure for group in groups for one in group if one.exposure is not None]
    stack, _ = develop_stack(groups, photographs.development, photographs.colour, min(times) if times else None)
    if stack.faults.shape[1:] != photographs.mask.shape:
        raise InputError(f"{groups[0][0].path}: is another size than the photographs; the ball must be taken with the same view")
    return stack.images, stack.faults


def _outline(folder: Path, ball: BallSpec, images: NDArray[np.float32], photographs: Photographs, key: str) -> Doubles:
    """Points (N, 2) of the ball's outline in the undistorted pictures."""
    development, size = photographs.development, photographs.view.size
    if ball.circle_px is not None:
        points = circle_points(Circle(*ball.circle_px))
        if development.camera is not None and development.distortion is not None:
            import cv2

            straight = cv2.undistortPoints(points[:, None], development.camera, development.distortion, P=development.camera)
            points = np.asarray(straight, float)[:, 0]
        return points
    if ball.mask is not None:
        path = existing(folder, ball.mask, f"{key.rsplit(': ')[-1]}.mask")
        return contour(development.mask(read_mask(path, size)))
    if ball.outline is not None:
        path = existing(folder, ball.outline, f"{key.rsplit(': ')[-1]}.outline")
        picture = photographs.colour.read(path)
        straight, _ = development.finish(*_bare(picture.linear, picture.faults, photographs), path)
        return circle_points(find_circle(grey(straight), key))
    return circle_points(find_circle(grey(images).max(axis=0), key))


def _bare(linear: Any, faults: Any, photographs: Photographs) -> tuple[Any, Any]:
    """An outline's picture is taken under other light than the ambient frame knows: that is put on again before it is taken off."""
    ambient = photographs.development.ambient
    return (linear if ambient is None or ambient.shape != linear.shape else linear + ambient), faults


def _one_each(found: int, count: int, where: str) -> None:
    if found != count:
        raise InputError(f"{where}: {found} for {count} pictures; there must be one a picture")


def _unit(vectors: Doubles) -> Doubles:
    unit: Doubles = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    return unit


def _numbers(words: list[str]) -> bool:
    try:
        [float(word) for word in words]
    except ValueError:
        return False
    return True
