"""`degloss recon`: the commands of the measurement. Nothing heavy is imported until a command runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter

from recon.benchmark.cli import bench
from recon.inspection.cli import inspect
from recon.multiview.cli import multiview

app = App(name="recon", help="Measure: remove the gloss, repair, photometric stereo, height, mesh.", help_format="plaintext")
app.command(bench)
app.command(inspect)
app.command(multiview)


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
    dilate: str = "1",
    lights: str | None = None,
    saturated: Literal["drop", "keep"] = "drop",
    shadows: Literal["keep", "drop"] = "keep",
    encoding: Literal["srgb", "linear"] | None = None,
    json: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
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
        The gloss remover, or none. Default: group from 3 pictures on where torch is installed, else chromaticity.
        `degloss recon methods` lists them.
    inpaint
        How defects are repaired, or none. Default: none after group, whose confidence says what to distrust, else telea.
    normals
        The photometric-stereo solver.
    height
        The integrator.
    threshold
        Specular reflectance above which a sample is a defect (1: as bright as white paper facing the light); otsu, chosen in each
        picture; or auto, chosen so too, but only where the capture has gloss to tell apart and its pictures contradict each other.
    dilate
        Pixels by which defects grow.
    lights
        The pictures to use, numbered from 1 in file order, such as 1,3,5. Default: all.
    saturated
        Whether clipped samples are left out where the other lights suffice, and repaired elsewhere, or used like all others.
    shadows
        Whether shadowed samples are used like all others, or left out where the other lights suffice.
    encoding
        How the files' numbers are meant. Default: 8-bit is sRGB, 16-bit and EXR are linear; what was taken is printed and
        recorded.
    json
        Print the metrics as one JSON object on stdout.
    """
    from dataclasses import replace

    from gen.capture import read_capture
    from gen.files import dumps, keep_apart, writing_folder
    from recon.choices import frame_numbers, settings_from
    from recon.compare import planned_rows
    from recon.output import write_into
    from recon.pipeline import measure
    from recon.progress import steps
    from recon.registry import default_methods
    from recon.tables import text_report

    settings = settings_from(gloss, inpaint, normals, height, threshold, dilate, saturated, shadows)
    chosen = frame_numbers(lights)
    keep_apart(capture, output)
    with writing_folder(output, "measurement") as folder, steps() as step:
        step("reading")
        pictures = read_capture(capture, encoding)
        if chosen is not None:
            pictures = pictures.select(chosen)
        gloss, inpaint = default_methods(pictures.count, gloss, inpaint)
        settings = replace(settings, gloss=gloss, repair=inpaint)
        step.expect(5 + len(planned_rows(settings, pictures.truth)))
        shape = measure(pictures, **vars(settings), progress=step)
        metrics = write_into(shape, folder, step)
    print(dumps(metrics) if json else f"{text_report(metrics)}\n\n{output / (metrics['report'] or 'metrics.json')}")


@app.command
def capture(
    folder: Path,
    /,
    *,
    encoding: Literal["srgb", "linear"] | None = None,
    json: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
) -> None:
    """Check a folder of photographs and say in plain words what is missing or doubtful.

    Reads the folder as `run` would, by its capture.yaml or in any other known layout, and looks at the lights, the balls they
    were measured on, exposure, brackets, colour, mask and scale. Where it cannot be measured as it is, the exit code is 2.

    Parameters
    ----------
    folder
        The folder of a capture.
    encoding
        How the files' numbers are meant, in place of what capture.yaml says.
    json
        Print one JSON object on stdout.
    """
    import textwrap

    from gen.errors import InputError
    from gen.files import dumps
    from recon.photo_check import check_photos

    findings = check_photos(folder, encoding)
    missing = [finding for finding in findings if finding.level == "missing"]
    if json:
        print(dumps({"folder": folder, "measurable": not missing, "findings": [vars(finding) for finding in findings]}))
    else:
        for finding in findings:
            print(textwrap.fill(finding.text, 110, initial_indent=f"{finding.level:<9} ", subsequent_indent=" " * 10))
        if not findings:
            print("nothing is missing or doubtful")
    if missing:
        what = "1 thing is" if len(missing) == 1 else f"{len(missing)} things are"
        raise InputError(f"{folder}: cannot be measured yet: {what} missing or wrong (see above); put it right and check again")


@app.command
def lights(
    folder: Path,
    /,
    *,
    strengths: Literal["equal", "unknown"] = "equal",
    write: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
    encoding: Literal["srgb", "linear"] | None = None,
    json: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
) -> None:
    """Find the lights of pictures that nobody measured, as far as pictures can tell, and say what they cannot.

    Prints the rows of a lights.txt, with what was assumed and what remains ambiguous as comments. The surface should be mostly matte, and
    at least five pictures are needed; measured lights, such as from a chrome ball, are better.

    Parameters
    ----------
    folder
        A folder of pictures, mask.png among them; with capture.yaml or without. Lights that it states are not looked at.
    strengths
        Whether the lights are equally strong, such as one lamp that was moved (or as the folder's light_intensities.txt says), or unknown.
    write
        Write lights.txt beside the pictures, and light_intensities.txt where strengths are unknown.
    encoding
        How the files' numbers are meant. Default: 8-bit is sRGB, 16-bit and EXR are linear.
    json
        Print one JSON object on stdout.
    """
    from gen.files import dumps
    from recon.unknown_lights import find_lights, next_step, read_pictures, remarks, table, write_lights

    pictures = read_pictures(folder, encoding)
    found = find_lights(pictures, strengths, str(folder))
    notes = remarks(found, strengths)
    written = write_lights(folder, found, pictures.names, notes, strengths) if write else []
    if json:
        rows = {"names": pictures.names, "lights": found.lights, "strengths": found.strengths}
        print(
            dumps(
                {"folder": folder, **rows, "misfit": found.misfit, "against": found.against, "notes": notes, "written": written}
            )
        )
        return
    print(table(found, pictures.names, notes), end="")
    if written:
        print(f"# written: {', '.join(map(str, written))}; next: {next_step(folder, written)}")


@app.command
def methods(*, json: Annotated[bool, Parameter(negative=(), show_default=False)] = False) -> None:
    """List the names of the gloss removers, repairs, solvers and integrators, each with its source.

    Parameters
    ----------
    json
        Print one JSON object on stdout.
    """
    import textwrap

    from gen.files import dumps
    from recon.registry import GLOSS, HEIGHT, NORMALS, REPAIR

    tables = {
        "--gloss": GLOSS.describe(),
        "--inpaint": REPAIR.describe(),
        "--normals": NORMALS.describe(),
        "--height": HEIGHT.describe(),
    }
    if json:
        print(dumps({option: {n: {"what": w, "source": s} for n, (w, s) in names.items()} for option, names in tables.items()}))
        return
    for option, names in tables.items():
        print(option)
        for name, (line, source) in names.items():
            print(f"  {name:<15} {line}")
            if source:
                print(textwrap.fill(source, 110, initial_indent=" " * 18, subsequent_indent=" " * 18))
