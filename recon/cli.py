"""`degloss recon`: the commands of the measurement. Nothing heavy is imported until a command runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter

app = App(name="recon", help="Measure: remove the gloss, repair, photometric stereo, height, mesh.")


@app.command
def run(
    capture: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    gloss: str | None = None,
    inpaint: str | None = None,
    normals: str | None = None,
    height: str | None = None,
    threshold: str = "auto",
    dilate: int = 1,
    lights: str | None = None,
    saturated: Literal["drop", "keep"] = "drop",
    shadows: Literal["keep", "drop"] = "keep",
    encoding: Literal["srgb", "linear"] | None = None,
    json: bool = False,
) -> None:
    """Measure the shape of a capture.

    Writes normal, height and albedo maps, the layers, the defects, mesh.ply, mesh.glb, metrics.json and report.html. Where the
    capture holds the truth, every row of the comparison is worked out against it; where it does not, no errors are given.

    Parameters
    ----------
    capture
        A folder of pictures with lights (our renders, DiLiGenT, RTI .lp, pictures with lights.txt), or a psmImages list file.
    output
        The folder to write; an earlier result there is replaced.
    gloss
        The gloss remover, or none. `degloss recon methods` lists them.
    inpaint
        How defects are repaired, or none.
    normals
        The photometric-stereo solver.
    height
        The integrator.
    threshold
        Specular reflectance above which a sample is a defect (1: as bright as white paper facing the light), or auto.
    dilate
        Pixels by which defects grow.
    lights
        The pictures to use, numbered from 1 in file order, such as 1,3,5. Default: all.
    saturated
        Whether clipped samples are left out where the other lights suffice.
    shadows
        Whether dark samples are left out where the other lights suffice.
    encoding
        How the files' numbers are meant. Default: 8-bit is sRGB, 16-bit and EXR are linear; what was taken is printed and
        recorded.
    json
        Print the metrics as one JSON object on stdout.
    """
    from gen.capture import read_capture
    from gen.files import dumps, writing_folder
    from recon.choices import frame_numbers, settings_from
    from recon.output import write_into
    from recon.pipeline import reconstruct, remove_gloss
    from recon.progress import steps
    from recon.tables import text_report

    settings = settings_from(gloss, inpaint, normals, height, threshold, dilate, saturated, shadows)
    chosen = frame_numbers(lights)
    with writing_folder(output) as folder, steps(total=9) as step:
        step("reading")
        pictures = read_capture(capture, encoding)
        if chosen is not None:
            pictures = pictures.select(chosen)
        step("removing the gloss")
        layers = remove_gloss(pictures, settings)
        shape = reconstruct(pictures, layers, settings, step)
        metrics = write_into(shape, folder, step)
    print(dumps(metrics) if json else f"{text_report(metrics)}\n\n{output / (metrics['report'] or 'metrics.json')}")


@app.command
def methods(*, json: bool = False) -> None:
    """List the names of the gloss removers, repairs, solvers and integrators.

    Parameters
    ----------
    json
        Print one JSON object on stdout.
    """
    from gen.files import dumps
    from recon.registry import GLOSS, HEIGHT, NORMALS, REPAIR

    tables = {registry.option: registry.describe() for registry in (GLOSS, REPAIR, NORMALS, HEIGHT)}
    if json:
        print(dumps(tables))
        return
    for option, names in tables.items():
        print(option)
        for name, line in names.items():
            print(f"  {name:<15} {line}")
