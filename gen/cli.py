"""The commands `degloss gen ...`. Nothing heavy is imported before a command runs, so that help is fast."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

app = App(
    name="gen", help="Render captures of glossy objects with headless Blender, with their whole truth.", help_format="plaintext"
)


@app.command
def render(
    spec: str,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    workers: int = 1,
    blender: str | None = None,
    seed: int | None = None,
    json: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
) -> None:
    """Render a capture: K pictures of one view, each under one light, and what is true of them.

    The folder holds one layered EXR a picture (combined, diffuse, specular and the matte twin), normals, depth, albedo and
    gloss of the view, the mask, and capture.json; every degloss command reads it. An earlier result there is replaced.

    Parameters
    ----------
    spec
        A YAML spec, or the name of a shipped preset (see degloss gen presets).
    output
        The folder to write.
    workers
        Blender processes that render at the same time. The pixels do not depend on it.
    blender
        An installed Blender's program, in place of the bpy module.
    seed
        Takes the place of the spec's seed.
    json
        Print one JSON object on stdout in place of a sentence.
    """
    import sys
    import time

    from gen.capture import Fault
    from gen.files import dumps
    from gen.render import render_capture
    from gen.spec import read_spec, with_seed

    wanted = read_spec(spec)
    if seed is not None:
        wanted = with_seed(wanted, seed)
    started = time.monotonic()
    with _progress(wanted.name) as progress:
        rendered = render_capture(wanted, output, workers=workers, blender=blender, progress=progress)
    took = time.monotonic() - started
    capture = rendered.capture
    H, W = capture.size
    facts = {
        "folder": str(output),
        "name": wanted.name,
        "pictures": capture.count,
        "size": [W, H],
        "object_share": float(capture.mask.mean()),
        "exposure": capture.provenance["exposure"],
        "clipped_samples": int(((capture.faults & Fault.CLIPPED) > 0).sum()),
        "spec_sha256": capture.provenance["spec_sha256"],
        "blender": capture.provenance["blender"],
        "seconds": round(took, 3),
        "render_seconds": round(rendered.seconds, 3),
    }
    if json:
        sys.stdout.write(dumps(facts) + "\n")
        return
    print(f"{output}: {capture.count} pictures of {W}x{H} in {took:.1f} s, exposure {facts['exposure']:g}")


@app.command
def presets(*, json: Annotated[bool, Parameter(negative=(), show_default=False)] = False) -> None:
    """List the shipped presets.

    Parameters
    ----------
    json
        Print one JSON object on stdout: name and description of each.
    """
    from gen.presets import describe_presets

    table = describe_presets()
    if json:
        from gen.files import dumps

        print(dumps(table, indent=1))
        return
    width = max(map(len, table))
    for name, text in table.items():
        print(f"{name:<{width}}  {text}")


@app.command
def schema() -> None:
    """Print the JSON schema of a spec, for editors that check YAML while it is written."""
    from gen.files import dumps
    from gen.spec import schema as spec_schema

    print(dumps(spec_schema(), indent=1))


@contextmanager
def _progress(name: str) -> Iterator[Callable[[int, int], None] | None]:
    """A progress bar with rate and time left on stderr, where that is a terminal; otherwise nothing."""
    import sys

    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(f"{name}: starting Blender", total=None, rate="")

        def advance(done: int, total: int) -> None:
            speed = bar.tasks[0].speed
            bar.update(task, description=name, completed=done, total=total, rate=f"{speed:.1f} pictures/s" if speed else "")

        yield advance
