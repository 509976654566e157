"""The command `degloss gen release`. Nothing heavy is imported before it runs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

if TYPE_CHECKING:
    from gen.sets.campaign import Engine
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
    workers: int | None = None,
    fractions: str | None = None,
    by: str | None = None,
    device: Literal["auto", "cpu", "gpu"] | None = None,
    blender: str | None = None,
    resume: Flag = False,
    json: Flag = False,
) -> None:
    """Make a release of a set: what a stranger can verify, load and cite.

    A rendered set that is screened and split becomes a folder of WebDataset shards by split, Parquet tables of every picture and of every
    one that was left out, a card for Hugging Face, croissant.json, datasheet, licence, citation, contact sheet, provenance, and BagIt
    manifests. The same set gives the same bytes; a date is in it only where the environment variable SOURCE_DATE_EPOCH says one.

    Given a spec, a preset or a plan of a set it renders, screens and splits first, all in one.

    Whatever interrupts it, the same command with --resume goes on, and ends with the same bytes. degloss gen verify proves a release.

    Parameters
    ----------
    source
        The folder of a rendered set, a YAML spec of a set, the name of a shipped preset, or a plan (degloss gen plan).
    version
        Of the release: three numbers such as 1.0.0.
    output
        The folder to make. It must not be there yet, nor lie in the set.
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
        Of a set that is rendered here: Blender processes at the same time. The bytes do not depend on it. Default: 1.
    fractions
        Of a set that is rendered here: the shares of train, validation and test (see degloss gen split). Default: 0.8,0.1,0.1.
    by
        Of a set that is rendered here: what splits must not share. Default: object,material,lights.
    device
        Of a set that is rendered here: what Blender computes on. Default: auto, a gpu where there is one.
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
    from gen.release.build import release_in, release_set, workplace
    from gen.sets.set_commands import progress_bar
    from gen.sets.set_folder import SetFolder, is_set_folder

    require("release")
    if not 1 <= shard_mb <= 100_000:
        raise InputError(f"--shard-mb {shard_mb}: must be from 1 to 100000")
    shard_bytes = shard_mb * 1_000_000

    def about(name: str, digest: str) -> About:
        return About(name, version, title or name, description or _described(name, digest), creator, license, url, release_date())

    if is_set_folder(Path(source)):
        for option, given in (
            ("--workers", workers),
            ("--fractions", fractions),
            ("--by", by),
            ("--device", device),
            ("--blender", blender),
        ):
            if given is not None:
                raise InputError(f"{option} is for sets that are rendered here, and {source} is rendered already")
        folder = SetFolder(Path(source))
        head = folder.about()
        said = about(str(head.get("name")), str(head.get("set_sha256")))
        with progress_bar(f"{said.identifier}: releasing", "captures") as bar:
            done = release_set(folder, output, said, shard_bytes, resume, bar)
    else:
        from gen.sets.campaign import Engine
        from gen.sets.set_commands import fractions_of, words
        from gen.sets.splits import KEYS, SHARES, check_options

        plan = _plan(source)
        said = about(plan.name, plan.set_sha256)
        wanted = SHARES if fractions is None else fractions_of(fractions)
        shares, keys = check_options(wanted, 0, tuple(KEYS) if by is None else words(by))
        engine = Engine(1 if workers is None else workers, blender=blender, device=device or "auto")
        with workplace(output, resume) as place:
            folder = _rendered(plan, place / "set", engine, shares, keys)
            with progress_bar(f"{said.identifier}: releasing", "captures") as bar:
                done = release_in(place, folder, output, said, shard_bytes, bar)
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
        raise InputError(f"{source}: is neither the folder of a rendered set (set.json) nor the spec, preset or plan of one")
    return plan_of(source)


def _described(name: str, digest: str) -> str:
    """What the preset of a set's name says of itself, where the set is that preset's by its digest; otherwise what any set is."""
    from gen.presets import describe_presets, preset_file, preset_names
    from gen.sets.set_spec import read_set

    if name in preset_names("set") and read_set(preset_file(name)).digest() == digest:
        return f"{describe_presets()[name].rstrip('.')}."
    return "Rendered pictures of glossy objects with diffuse and specular layers, gloss-free twins, and the true shape."


def _rendered(plan: Plan, folder: Path, engine: Engine, shares: tuple[float, ...], keys: tuple[str, ...]) -> SetFolder:
    """The plan as a rendered, screened and divided set; what is there of it is kept."""
    from gen.sets.campaign import render_set
    from gen.sets.screening import write_screening
    from gen.sets.set_commands import progress_bar
    from gen.sets.set_folder import SetFolder
    from gen.sets.splits import write_splits

    with progress_bar(f"{plan.name}: rendering", "items") as bar:
        advance = None if bar is None else lambda done, total, pictures: bar(done, total)
        render_set(plan, folder, engine, True, advance)
    found = SetFolder(folder)
    write_screening(found)
    write_splits(found, shares, 0, keys)
    return found
