"""Makes the figures of these pages: `python docs/figures/make.py [NAME...]`, all of them without a name (minutes; Blender is needed).

Every picture comes out of the product: renders, measurements and reference formulas, nothing retouched.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).resolve().parent
Picture = NDArray[np.uint8]
Tile = tuple[str, Picture | None]

GAP, HEAD, LABEL = 8, 20, 128
PAPER, INK, BEHIND = (252, 251, 249), (40, 42, 46), (226, 226, 222)
ALPHAS = (0.05, 0.2, 0.4618)
STYLE = (
    "<style>svg{background:#fcfbf9;font-family:sans-serif;font-size:12px}text{fill:#555}.title{fill:#282a2e}.grid{stroke:#e3e1dc}"
    ".axis{stroke:#888}.curve{fill:none;stroke-width:2}.c0{stroke:#1b4f8a}.c1{stroke:#c2571a}.c2{stroke:#3a7d44}"
    ".c3{stroke:#8a3a7d}.c4{stroke:#777}.dashed{stroke-dasharray:6 4}</style>"
)


def sheet(name: str, rows: Sequence[Sequence[Tile]], side: int) -> None:
    """Write rows of titled tiles, each scaled to `side` pixels high, as NAME.png; a tile without a picture is a label."""
    from PIL import Image, ImageDraw, ImageFont

    def scaled(picture: Picture) -> Image.Image:
        image = Image.fromarray(picture)
        return image.resize((round(image.width * side / image.height), side), Image.Resampling.LANCZOS)

    drawn = [[(title, None if picture is None else scaled(picture)) for title, picture in row] for row in rows]
    columns = range(max(map(len, drawn)))
    widths = [max(image.width if image else LABEL for row in drawn for _, image in row[c : c + 1]) for c in columns]
    canvas = Image.new("RGB", (GAP + sum(w + GAP for w in widths), GAP + len(rows) * (side + HEAD + GAP)), PAPER)
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(13)
    for r, row in enumerate(drawn):
        for c, (title, image) in enumerate(row):
            x, y = GAP + sum(w + GAP for w in widths[:c]), GAP + r * (side + HEAD + GAP)
            draw.text((x, y if image else y + HEAD + side // 2 - 8), title, INK, font)
            if image is not None:
                canvas.paste(image, (x, y + HEAD))
    canvas.save(HERE / f"{name}.png", optimize=True)


def plot(
    name: str, title: str, x_title: str, y_title: str, x: NDArray[np.float64], curves: dict[str, NDArray[np.float64]]
) -> None:
    """Write curves over one axis, with a legend, as NAME.svg."""
    from recon.page_parts import Plot, Series
    from recon.page_plot import curves as drawn

    svg = drawn(Plot(title, [Series(key, x.tolist(), y.tolist()) for key, y in curves.items()], x_title, y_title))
    legend = f'<rect x="548" y="14" width="204" height="{18 * len(curves) + 4}" fill="#fcfbf9"/>' + "".join(
        f'<path class="curve c{i}" d="M560 {26 + 18 * i}h26"/><text x="594" y="{30 + 18 * i}">{key}</text>'
        for i, key in enumerate(curves)
    )
    svg = svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" width="760" height="300" ', 1)
    body = svg.index(">") + 1
    (HERE / f"{name}.svg").write_text(
        svg[:body] + STYLE + svg[body:].replace("</svg>", f"{legend}</svg>") + "\n", encoding="utf-8"
    )


def lobes() -> None:
    """How fast a highlight fades from its middle, by alpha."""
    from gen.substrate import trowbridge_reitz

    angle = np.linspace(0, 45, 181)
    cosine = np.cos(np.radians(angle))
    shown = {f"alpha {a:g}": trowbridge_reitz(cosine, a) / trowbridge_reitz(np.ones(1), a) for a in (0.05, 0.1, 0.2, 0.4618, 0.7)}
    plot(
        "lobes",
        "Width of a highlight by alpha",
        "angle between normal and half vector, degrees",
        "brightness over its peak",
        angle,
        shown,
    )


def coat() -> None:
    """What the substrate's coat leaves of its base, beside a Lambertian surface."""
    from recon.normals.coat import dimming

    angle = np.linspace(0, 89, 179)
    cosine = np.cos(np.radians(angle))
    ahead = np.ones(1)
    shown = {"Lambert: the cosine": cosine, "under a coat": cosine * dimming(cosine, ahead) / dimming(ahead, ahead)}
    plot(
        "coat",
        "The coated base is not Lambertian",
        "angle of the light to the normal, degrees",
        "brightness over its peak",
        angle,
        shown,
    )


def materials() -> None:
    """Every material on a sphere under one light: three widths of highlight, and the layers of the middle one."""
    from gen.farm import Farm
    from gen.spec_materials import MATERIALS

    rows: list[list[Tile]] = []
    with Farm(1) as farm:
        for kind in MATERIALS:
            tiles: list[Tile] = [(kind, None)]
            for alpha in ALPHAS:
                values = {"metal": {"specular": [0.95, 0.64, 0.4]}}.get(kind, {"albedo": [0.2, 0.35, 0.5]})
                if kind != "lambertian":
                    values = {**values, "alpha": alpha}
                if kind in ("substrate", "approximate-substrate"):
                    values["specular"] = 0.3
                if kind.startswith("blinn-phong"):
                    values["specular"] = 0.5
                pictures = rendered(farm, {"name": "sphere"}, {"kind": kind, **values})
                tiles.append(("" if kind == "lambertian" else f"alpha {alpha:g}", pictures["picture"]))
                if kind == "lambertian":
                    break
                if alpha == ALPHAS[1]:
                    middle = [(f"its {name}", pictures[name]) for name in ("diffuse", "specular", "matte")]
            rows.append(tiles if kind == "lambertian" else tiles + middle)
    sheet("materials", rows, 104)


def shapes() -> None:
    """Every shape as it is without parameters."""
    from blender_scenes.shapes import SHAPES
    from gen.farm import Farm

    turned = {
        "flange": [-25, 30, 0],
        "gear": [-25, 30, 0],
        "torus": [-30, 20, 0],
        "pipe_elbow": [15, -50, 0],
        "turbine_blade": [0, -20, 8],
        "relief": [-25, 15, 0],
    }
    with Farm(1) as farm:
        tiles: list[Tile] = []
        for name in SHAPES:
            pose = turned.get(name, [25, 20, 0])
            made = rendered(
                farm, {"name": name}, {"kind": "substrate", "albedo": [0.55, 0.3, 0.2], "specular": 0.2, "alpha": 0.2}, pose, 66
            )
            tiles.append((name, made["picture"]))
    sheet("shapes", [tiles[k : k + 6] for k in range(0, len(tiles), 6)], 136)


def rendered(
    farm: object, shape: dict, material: dict, pose: Sequence[float] = (0, 0, 0), width_mm: float = 54
) -> dict[str, Picture]:
    """The picture and its layers, as sRGB at one exposure, of a shape under one light."""
    from gen.render import render
    from gen.spec import spec_from
    from recon.pictures import tone

    spec = spec_from(
        {
            "name": "figure",
            "resolution": [160, 160],
            "supersampling": 2,
            "shape": shape,
            "material": material,
            "pose": {"rotation_degrees": list(pose)},
            "lights": [[-0.35, 0.35, 0.87]],
            "camera": {"kind": "orthographic", "width_mm": width_mm},
            "exposure": 1.0,
        },
        "figure",
    )
    capture = render(spec, farm=farm).capture  # type: ignore[arg-type]
    layers = {"picture": capture.images, "diffuse": capture.truth.diffuse, "specular": capture.truth.specular}
    layers["matte"] = capture.truth.matte
    shown = {name: tone(stack[0], 0.8) for name, stack in layers.items() if stack is not None}
    return {name: np.where(capture.mask[..., None], picture, BEHIND).astype(np.uint8) for name, picture in shown.items()}


def removers() -> None:
    """What each remover makes of the paper's cylinder, and the error of the normals after it."""
    from gen.render import render
    from gen.spec import read_spec
    from recon.metrics import angular_error
    from recon.pictures import crop_to_mask, error_picture, tone, white_of
    from recon.pipeline import measure
    from recon.registry import GLOSS

    capture = render(read_spec("paper-cylinder")).capture
    white = white_of(capture.images, capture.mask)
    tiles: list[tuple[Tile, Tile]] = []
    assert capture.truth.normals is not None
    for name in GLOSS:
        shape = measure(capture, name, "none", height="quadratic")
        error = angular_error(shape.normals.normal, capture.truth.normals)
        mean = float(np.nanmean(error[capture.mask]))
        tiles.append(
            (
                (name, crop_to_mask(tone(shape.images[0], white), capture.mask, 6)),
                (f"{mean:.1f} degrees", crop_to_mask(error_picture(error, capture.mask, 30), capture.mask, 6)),
            )
        )
    rows: list[list[Tile]] = []
    for part in (tiles[:6], tiles[6:]):
        rows += [[picture for picture, _ in part], [error for _, error in part]]
    sheet("removers", rows, 150)


def integrators() -> None:
    """The integrators on a sheet with a flap that is bent up: a step in height on both of its sides."""
    from gen.capture import Scale
    from recon.height.bench import relief
    from recon.pictures import relief_picture
    from recon.registry import HEIGHT

    normal, true = relief(192)
    low, high = float(true.min()), float(true.max())
    rows: list[Tile] = [("true height", relief_picture(true, low, high))]
    for name in HEIGHT:
        found = HEIGHT.load(name)(normal.astype(np.float32), np.ones(true.shape, bool), Scale()).height
        off = found - true
        off -= np.median(off)
        rows.append(
            (f"{name}: {100 * float(np.abs(off).mean()) / (high - low):.1f} % off", relief_picture(true + off, low, high))
        )
    sheet("integrators", [rows], 170)


def tutorial() -> None:
    """The photographs of the tutorial, and what is measured from them."""
    import cv2

    sys.path.insert(0, str(HERE.parent / "examples"))
    import photographs

    from gen.capture import read_capture
    from recon.inspection.inspection import inspect
    from recon.inspection.maps import deviation_map
    from recon.inspection.measured import of_shape
    from recon.inspection.nominal import read_nominal
    from recon.pictures import crop_to_mask, normal_picture, relief_picture
    from recon.pipeline import measure

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "button"
        photographs.write(folder)
        (folder / "capture.yaml").write_text(capture_yaml(), encoding="utf-8")
        shown = [("the short exposure", "02-a.png"), ("the long exposure", "02-b.png"), ("another lamp", "05-b.png")]
        first: list[Tile] = []
        for title, name in shown:
            raw = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)[..., ::-1]
            first.append((title, (255 * (raw / 65535.0) ** (1 / 2.2)).astype(np.uint8)))
        sheet("photographs", [first], 150)
        capture = read_capture(folder)
        shape = measure(capture)
        found = inspect(of_shape(shape), read_nominal(folder / "nominal.ply", "m"), tolerance=0.05)
        height = shape.height.height
        low, high = float(np.nanmin(height)), float(np.nanmax(height))
        step = capture.scale.metres_per_pixel or 1.0
        tiles: list[Tile] = [
            ("normals", normal_picture(shape.normals.normal, shape.normals.measurable)),
            ("relief", relief_picture(height, low, high, step)),
            ("deviation, form removed", deviation_map(found, "features")[0]),
        ]
        sheet("button", [[(title, crop_to_mask(picture, capture.mask, 6)) for title, picture in tiles]], 220)


def capture_yaml() -> str:
    """The capture.yaml of the tutorial, as it stands there."""
    text = (HERE.parent / "tutorial.md").read_text(encoding="utf-8")
    return text.split("```yaml\n")[1].split("```")[0]


FIGURES: dict[str, Callable[[], None]] = {
    figure.__name__: figure for figure in (lobes, coat, materials, shapes, removers, integrators, tutorial)
}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", choices=[*FIGURES, []], metavar="NAME", help=f"which: {', '.join(FIGURES)}")
    for wanted in parser.parse_args().names or FIGURES:
        FIGURES[wanted]()
        print(wanted)
