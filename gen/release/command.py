"""The command `degloss gen release`. Nothing heavy is imported before it runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from gen.release.about import About
    from gen.sets.plan import Plan
    from gen.sets.set_folder import SetFolder

Flag = Annotated[bool, Parameter(negative=(), show_default=False)]


def release(
    source: str,
    /,
    *,
    version: str,
    output: Annotated[Path, Parameter(name=["--output", "-o"])],
    title: str | None = None,
    description: str | None = None,
    creator: str = "degloss",
    license: str = "CC-BY-4.0",
    url: str | None = None,
    shard_mb: int = 500,
    workers: int = 1,
    fractions: str = "0.8,0.1,0.1",
    by: str = "object,material,lights",
    device: Literal["auto", "cpu", "gpu"] = "auto",
    blender: str | None = None,
    resume: Flag = False,
    json: Flag = False,
) -> None:
    """Make a release of a set: what a stranger can verify, load and cite.

    A rendered set that is screened and split becomes a folder of WebDataset shards by split, Parquet tables of every picture and of every
    one that was left out, a card for Hugging Face, croissant.json, datasheet, licence, citation, contact sheet, provenance, and BagIt
    manifests. The same set gives the same bytes; a date is in it only where the environment variable SOURCE_DATE_EPOCH says one.

    Given a spec or a preset of a set it renders, screens and splits first, all in one.

    Whatever interrupts it, the same command with --resume goes on, and ends with the same bytes. degloss gen verify proves a release.

    Parameters
    ----------
    source
        The folder of a rendered set, a YAML spec of a set, or the name of a shipped preset.
    version
        Of the release: three numbers such as 1.0.0.
    output
        The folder to make. It must not be there yet.
    title
        Of the data set. Default: the set's name.
    description
        A sentence or two. Default: that of the preset of the set's name, where it is one.
    creator
        Who is named as the data set's creator.
    license
        Of the data: CC-BY-4.0, CC-BY-SA-4.0 or CC0-1.0.
    url
        Where the data set can be found.
    shard_mb
        Size of a shard in megabytes, about.
    workers
        Of a set that is rendered here: Blender processes at the same time. The bytes do not depend on it.
    fractions
        Of a set that is rendered here: the shares of train, validation and test (see degloss gen split).
    by
        Of a set that is rendered here: what splits must not share.
    device
        Of a set that is rendered here: what Blender computes on.
    blender
        Of a set that is rendered here: an installed Blender's program, in place of the bpy module.
    resume
        Go on with an unfinished release.
    json
        Print one JSON object on stdout in place of a sentence.
    """
    from dataclasses import asdict

    from gen.errors import InputError
    from gen.files import dumps
    from gen.parts import require
    from gen.release.about import About, release_date
    from gen.release.build import Released, release_in, workplace
    from gen.sets.set_commands import progress_bar, words
    from gen.sets.set_folder import SetFolder, is_set_folder

    require("release")
    if not 1 <= shard_mb <= 100_000:
        raise InputError(f"--shard-mb {shard_mb}: must be from 1 to 100000")

    def about(name: str, digest: str) -> About:
        return About(name, version, title or name, description or _described(name, digest), creator, license, url, release_date())

    def build(place: Path, folder: SetFolder, said: About) -> Released:
        with progress_bar(f"{said.identifier}: releasing", "captures") as bar:
            return release_in(place, folder, output, said, shard_mb * 1_000_000, bar)

    if is_set_folder(Path(source)):
        folder = SetFolder(Path(source))
        head = folder.about()
        said = about(str(head.get("name")), str(head.get("set_sha256")))
        with workplace(output, resume) as place:
            done = build(place, folder, said)
    else:
        plan = _plan(source)
        said = about(plan.name, plan.set_sha256)
        with workplace(output, resume) as place:
            folder = _rendered(plan, place / "set", workers, device, blender, fractions, words(by))
            done = build(place, folder, said)
    if json:
        print(dumps({"folder": str(output), "name": said.name, "version": version, **asdict(done)}))
        return
    kept = f", {done.kept} of them were there" if done.kept else ""
    print(
        f"{output}: {said.identifier}: {done.items:,} captures, {done.pictures:,} pictures, {done.rejected:,} left out, "
        f"{done.shards:,} shards{kept}, {done.bytes / 1e6:,.1f} MB"
    )


def _plan(source: str) -> Plan:
    """The plan of a set spec, a preset, or a plan's file."""
    from gen.errors import InputError
    from gen.sets.plan import is_plan, is_set, plan_of, read_plan

    if is_plan(source):
        return read_plan(source)
    if not is_set(source):
        raise InputError(f"{source}: is neither the folder of a rendered set (set.json) nor the spec or preset of a set")
    return plan_of(source)


def _described(name: str, digest: str) -> str:
    """What the preset of a set's name says of itself, where the set is that preset's by its digest; otherwise what any set is."""
    from gen.presets import describe_presets, preset_file, preset_names
    from gen.sets.set_spec import read_set

    if name in preset_names("set") and read_set(preset_file(name)).digest() == digest:
        return f"{describe_presets()[name].rstrip('.')}."
    return "Rendered pictures of glossy objects with diffuse and specular layers, gloss-free twins, and the true shape."


def _rendered(
    plan: Plan, folder: Path, workers: int, device: str, blender: str | None, fractions: str, by: tuple[str, ...]
) -> SetFolder:
    """The plan as a rendered, screened and divided set; what is there of it is kept."""
    from gen.sets.campaign import Engine, render_set
    from gen.sets.screening import write_screening
    from gen.sets.set_commands import fractions_of, progress_bar
    from gen.sets.set_folder import SetFolder
    from gen.sets.splits import write_splits

    shares = fractions_of(fractions)
    with progress_bar(f"{plan.name}: rendering", "items") as bar:
        advance = None if bar is None else lambda done, total, pictures: bar(done, total)
        render_set(plan, folder, Engine(workers, blender=blender, device=device), True, advance)
    found = SetFolder(folder)
    write_screening(found)
    write_splits(found, shares, 0, by)
    return found
