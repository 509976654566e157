"""`degloss recon multiview`: the command of the measurement from several views. Nothing heavy is imported until it runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from recon.reconstruct import Settings


def multiview(
    views: Path,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    gloss: Annotated[list[str] | None, Parameter(negative=())] = None,
    inpaint: str | None = None,
    normals: str | None = None,
    voxel: float | None = None,
    json: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
) -> None:
    """Measure an object from several sides: photometric stereo of each view, stereo between them, one mesh.

    Writes mesh.ply, mesh.glb, the depth of every view, metrics.json and report.html. Where the captures hold the truth, the mesh is
    compared with it, beside the meshes with the gloss left in and of the matte twin.

    Parameters
    ----------
    views
        A folder with cameras.json, which names captures and says where each camera stood, or a rendered set such as the preset
        multiview-ring. Neighbouring views must be 2 to 40 degrees apart, the cameras perspective.
    output
        The folder to write; an earlier result there is replaced.
    gloss
        The gloss remover, or none; may be given several times: the first makes the mesh, the others are compared. Default: group with
        3 pictures a view or more where torch is installed, else chromaticity.
    inpaint
        How defects are repaired, or none. Default: none after group, else telea.
    normals
        The photometric-stereo solver.
    voxel
        Side in mm of the cells in which the views are fused. Default: a pixel at the object.
    json
        Print the metrics as one JSON object on stdout.
    """
    from gen.files import dumps, keep_apart, writing_folder
    from recon.choices import settings_from
    from recon.multiview.measure import compare_rows, rows_text
    from recon.multiview.output import write_models
    from recon.multiview.views import read_views
    from recon.progress import steps
    from recon.registry import default_methods

    def chosen(pictures: int) -> list[Settings]:
        names: list[str | None] = [*gloss] if gloss else [None]
        methods = [default_methods(pictures, name, inpaint) for name in names]
        return [settings_from(name, repair, normals, None, "auto", "1", "drop", "keep") for name, repair in methods]

    chosen(3)  # a slip in a name is said before anything is read
    keep_apart(views, output)
    with writing_folder(output, "multi-view measurement") as folder, steps() as step:
        step("reading")
        every, ball = read_views(views)
        wanted = chosen(min(view.capture.count for view in every))
        models, figures = compare_rows(every, ball, wanted, voxel, progress=step)
        metrics = write_models(views, ball, models, figures, wanted[0].gloss, folder)
    print(dumps(metrics) if json else f"{rows_text(figures)}\n\n{output / (metrics['report'] or 'mesh.ply')}")
