"""The commands `degloss gen ...`. Nothing heavy is imported before a command runs, so that help is fast."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter

from gen.convert.command import convert
from gen.release.command import release
from gen.sets.set_commands import pack, preview, screen, split, verify

if TYPE_CHECKING:
    from gen.sets.campaign import Tally
    from gen.sets.plan import Plan

Flag = Annotated[bool, Parameter(negative=(), show_default=False)]
Device = Literal["auto", "cpu", "gpu"]

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
    engine: Literal["local", "ray"] = "local",
    address: str | None = None,
    resume: Flag = False,
    device: Device = "auto",
    blender: str | None = None,
    seed: int | None = None,
    limit: int | None = None,
    json: Flag = False,
) -> None:
    """Render a capture, K pictures of one view, each under one light, and what is true of them; or a whole set of captures.

    The spec of a capture gives one folder: one layered EXR a picture (combined, diffuse, specular and the matte twin), normals,
    depth, albedo and gloss of the view, the mask, and capture.json; every degloss command reads it. An earlier result there is
    replaced.

    The spec of a set, or a plan made of it, gives a folder of such folders with an index. It is rendered item by item: whatever
    interrupts it, the same command with --resume goes on. Items that cannot be rendered are left out and named at the end.

    Parameters
    ----------
    spec
        A YAML spec of a capture or a set, the name of a shipped preset (see degloss gen presets), or a plan (degloss gen plan).
    output
        The folder to write.
    workers
        Blender processes that render at the same time. The pixels do not depend on it.
    engine
        What renders a set: processes of this machine, or Ray.
    address
        The Ray cluster to use, whose machines share the file system of the output; without it Ray is started here.
    resume
        Go on with a set that is there in part, and try again what could not be rendered.
    device
        What Blender computes on. The gpu's pictures may differ from the cpu's in the last bit; auto takes a gpu where there is one.
    blender
        An installed Blender's program, in place of the bpy module.
    seed
        Takes the place of the spec's seed.
    limit
        Of a set only so many items, evenly spaced: a smaller set for a first look.
    json
        Print one JSON object on stdout in place of a sentence.
    """
    from gen.sets.plan import is_plan, is_set

    if is_plan(spec) or is_set(spec):
        from gen.sets.campaign import Engine, render_set

        ready = Engine(workers, engine, address, blender, device)
        plan = _plan(spec, seed, limit)
        with _progress(plan.name, "items") as bar:
            _report(output, plan.name, lambda: render_set(plan, output, ready, resume, bar), json)
        return
    for option, given in (
        ("--engine", engine != "local"),
        ("--address", address is not None),
        ("--resume", resume),
        ("--limit", limit is not None),
    ):
        if given:
            from gen.errors import InputError

            raise InputError(f"{option} is for sets, and {spec} is not the spec of one")
    _render_capture(spec, output, workers, blender, device, seed, json)


@app.command
def render_chunk(
    plan: str,
    /,
    *,
    index: int,
    chunks: int,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    workers: int = 1,
    device: Device = "auto",
    blender: str | None = None,
    json: Flag = False,
) -> None:
    """Render one part of a plan: for job arrays, whose tasks run where and when they like and share a file system.

    All of them write into the same folder. Whichever ends last writes its index; if one was killed, run it again, or let
    degloss gen render PLAN -o DIR --resume render what is missing. What is there is never rendered twice.

    Slurm: sbatch --array=0-99 --wrap 'degloss gen render-chunk PLAN --index $SLURM_ARRAY_TASK_ID --chunks 100 -o DIR'

    Kubernetes, a Job with completionMode: Indexed and completions: 100:
    degloss gen render-chunk PLAN --index $JOB_COMPLETION_INDEX --chunks 100 -o DIR

    Parameters
    ----------
    plan
        A plan (degloss gen plan), the same for all parts.
    index
        Which part, from 0.
    chunks
        How many parts there are.
    output
        The set's folder, the same for all parts.
    workers
        Blender processes that render at the same time.
    device
        What Blender computes on.
    blender
        An installed Blender's program, in place of the bpy module.
    json
        Print one JSON object on stdout in place of a sentence.
    """
    from gen.sets.campaign import Engine, render_set
    from gen.sets.plan import read_plan

    whole = read_plan(plan)
    part, ready = whole.chunk(index, chunks), Engine(workers, blender=blender, device=device)
    with _progress(f"{whole.name} {index}/{chunks}", "items") as bar:
        _report(output, whole.name, lambda: render_set(whole, output, ready, True, bar, part), json)


@app.command
def plan(
    spec: str,
    /,
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    seed: int | None = None,
    limit: int | None = None,
    json: Flag = False,
) -> None:
    """Write the plan of a set: every capture of it with every value drawn, one JSON line each.

    The same set spec gives the same plan, byte for byte.

    Parameters
    ----------
    spec
        A YAML spec of a set, or the name of a shipped preset (see degloss gen presets).
    output
        The file to write, by custom PLAN.jsonl.
    seed
        Takes the place of the spec's seed.
    limit
        Only so many items, evenly spaced.
    json
        Print one JSON object on stdout in place of a sentence.
    """
    import os

    from gen.errors import InputError
    from gen.files import dumps
    from gen.sets.plan import write_plan

    if os.path.isfile(spec) and os.path.realpath(output) == os.path.realpath(spec):
        raise InputError(f"{output}: is the spec itself; choose another place with -o")
    made = _plan(spec, seed, limit)
    write_plan(made, output)
    if json:
        print(dumps({"file": str(output), "name": made.name, "items": len(made.items), "plan_sha256": made.digest()}))
        return
    print(f"{output}: {len(made.items)} captures of the set {made.name}")


@app.command
def presets(*, json: Flag = False) -> None:
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


def _render_capture(
    spec: str, output: Path, workers: int, blender: str | None, device: str, seed: int | None, json: bool
) -> None:
    import sys
    import time

    from gen.capture import Fault
    from gen.farm import Farm
    from gen.files import dumps
    from gen.render import render_capture
    from gen.spec import read_spec, with_seed

    wanted = read_spec(spec)
    if seed is not None:
        wanted = with_seed(wanted, seed)
    started = time.monotonic()
    with _progress(wanted.name, "pictures") as progress, Farm(workers, blender, device=device) as farm:
        rendered = render_capture(wanted, output, progress=progress, farm=farm)
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


def _plan(spec: str, seed: int | None, limit: int | None) -> Plan:
    """The plan in a file, or of a set spec or preset."""
    from dataclasses import replace

    from gen.errors import InputError
    from gen.sets.plan import is_plan, plan_of, read_plan
    from gen.sets.set_spec import evenly

    if not is_plan(spec):
        with _progress(f"{spec}: planning", "items") as bar:
            return plan_of(spec, limit, bar, seed)
    if seed is not None:
        raise InputError(f"--seed {seed}: {spec} is a plan, in which everything is drawn; give the seed to degloss gen plan")
    whole = read_plan(spec)
    return replace(whole, items=tuple(whole.items[i] for i in evenly(len(whole.items), limit)))


def _report(output: Path, name: str, run: Callable[[], Tally], json: bool) -> None:
    """Run a campaign and say what came of it; InputError at the end where items are in quarantine."""
    import time

    from gen.errors import InputError
    from gen.files import dumps

    started = time.monotonic()
    tally = run()
    took = time.monotonic() - started
    if json:
        facts = {"folder": str(output), "name": name, **asdict(tally), "seconds": round(took, 3)}
        print(dumps({**facts, "pictures_per_second": round(tally.pictures / max(took, 1e-9), 3)}))
    else:
        before = f"; {tally.kept} were there" if tally.kept else ""
        rest = "" if tally.indexed else "; the rest of the set is still to come"
        speed = f", {tally.pictures / took:.1f} pictures/s" if tally.pictures else ""
        print(f"{output}: {tally.rendered} items, {tally.pictures} pictures in {took:.1f} s{speed}{before}{rest}")
    if tally.quarantined:
        raise InputError(
            f"{output}: {tally.quarantined} items could not be rendered and are in quarantine (index.jsonl and events.jsonl "
            "say why); the same command with --resume tries them again"
        )


@contextmanager
def _progress(name: str, unit: str) -> Iterator[Callable[..., None] | None]:
    """A progress bar on stderr with rate and time left, where that is a terminal; otherwise nothing.

    unit: what is counted. Called with (done, in all), for a set also with the pictures so far, whose rate is then shown.
    """
    import sys
    import time

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
    started = time.monotonic()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(f"{name}: starting", total=None, rate="")

        def advance(done: int, total: int, pictures: int | None = None) -> None:
            speed = bar.tasks[0].speed if pictures is None else pictures / (time.monotonic() - started)
            counted = unit if pictures is None else "pictures"
            bar.update(task, description=name, completed=done, total=total, rate=f"{speed:.1f} {counted}/s" if speed else "")

        yield advance


for _command in (verify, screen, split, preview, pack, release, convert):
    app.command(_command)
