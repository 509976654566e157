"""`degloss recon inspect`: the command of the inspection."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

Flag = Annotated[bool, Parameter(negative=(), show_default=False)]
Unit = Literal["um", "mm", "cm", "m", "inch"]


def inspect(
    measured: Path,
    nominal: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    tolerance: float,
    guard: float = 2.0,
    cutoff: float | None = None,
    unit: Unit | None = None,
    measured_unit: Unit | None = None,
    uncertainty: float | None = None,
    initial_pose: str | None = None,
    seed: int = 0,
    check: Flag = False,
    json: Flag = False,
) -> None:
    """Compare a measured part with its nominal mesh, against a tolerance.

    Aligns the nominal, maps the deviation raw and with the form removed, and says of the features in between: pass, fail, or cannot be
    decided. Form longer than the cut-off is never judged: photometric stereo does not measure it. Writes maps (EXR, PNG), inspection.json
    and report.html.

    Parameters
    ----------
    measured
        The folder that `degloss recon run` wrote, or a mesh in the camera's frame (x right, y up, z to the viewer).
    nominal
        The nominal mesh: GLB, STL, OBJ or PLY.
    output
        The folder to write; an earlier result there is replaced.
    tolerance
        The deviation allowed to each side, in millimetres. Where the measurement has no scale: of the nominal, which sets it.
    guard
        Width of the guard band in standard deviations (ISO 14253-1).
    cutoff
        The longest wavelength that is judged, in millimetres. Default: a quarter of the shorter side of what was
        measured, rounded down to 1, 2, 2.5, 5 or 8 of a decade.
    unit
        Of the nominal's numbers. Default: metres for GLB, else millimetres; what was taken is said.
    measured_unit
        Of a measured mesh's numbers. Default: what the file says, else as for the nominal.
    uncertainty
        Of the measured normals, one standard deviation in degrees, in place of what the measurement states.
    initial_pose
        Three angles in degrees, such as 0,90,0: turns of the nominal about the camera's x, y and z to align from.
        Default: all sides are tried.
    seed
        Of the draws that give the uncertainty.
    check
        Exit with code 1 where the features fail and 3 where it cannot be decided.
    json
        Print the figures as one JSON object on stdout.
    """
    import sys

    from gen.files import dumps, keep_apart, writing_folder
    from recon.inspection.inspection import inspect as inspected
    from recon.inspection.measured import read_measured
    from recon.inspection.nominal import read_nominal
    from recon.inspection.output import write_into
    from recon.inspection.pose import initial_rotation
    from recon.inspection.verdict import require_tolerance
    from recon.progress import steps

    require_tolerance(tolerance, guard)
    initial = None if initial_pose is None else initial_rotation(initial_pose)
    keep_apart(measured, output)
    keep_apart(nominal, output)
    with writing_folder(output, "inspection") as folder, steps() as step:
        step("reading")
        part, surface = read_measured(measured, measured_unit, uncertainty), read_nominal(nominal, unit)
        step.expect(3)
        found = inspected(part, surface, tolerance, guard, cutoff, initial, seed=seed, progress=step)
        step("writing")
        figures = write_into(found, folder)
    print(dumps(figures) if json else f"{found.text()}\n\n{output / (figures['report'] or 'inspection.json')}")
    if check and found.verdict.features != "pass":
        sys.exit(1 if found.verdict.features == "fail" else 3)
