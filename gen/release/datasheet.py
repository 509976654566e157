"""DATASHEET.md: the questions of "Datasheets for Datasets" (Gebru, Morgenstern, Vecchione, Vaughan, Wallach, Daume III, Crawford, 2021)."""

from __future__ import annotations

from gen.release.about import About
from gen.release.facts import Facts


def datasheet(about: About, facts: Facts) -> str:
    """The text of DATASHEET.md. What concerns people is answered once: there are none in the data."""
    return "\n".join(
        (
            f"# Datasheet of {about.title} {about.version}\n",
            _motivation(about),
            _composition(facts),
            _collection(facts),
            _rest(about, facts),
        )
    )


def _motivation(about: About) -> str:
    return f"""## Motivation

**For what purpose was it made?** {about.description} Pictures of glossy objects with their gloss-free twins and the true shape cannot be
photographed; they can be rendered.

**Who made it?** {about.creator}. The program degloss rendered it.
"""


def _composition(facts: Facts) -> str:
    splits = ", ".join(f"{name} {items:,} ({pictures:,} pictures)" for name, (items, pictures) in facts.splits.items())
    out = ", ".join(f"{n:,} {reason}" for reason, n in facts.rejected.items()) or "none"
    notes = f" Exceptions: {'; '.join(facts.notes)}." if facts.notes else ""
    return f"""## Composition

**What are the instances?** Captures: pictures of one rendered object from one view, each under a known light, with layers and truth.

**How many are there?** {facts.items:,} captures, {facts.pictures:,} pictures: {splits}.

**Is it a sample of something larger?** The plan drew {facts.planned:,} captures from the ranges of its spec. Pictures left out: {out}.
`data/rejected.parquet` names each with its reason. Screening leaves out single training pictures with overexposed pixels, so very bright
highlights are rarer in them than the plan alone would have it.

**Are there labels?** The truth comes from the renderer: diffuse and specular layer, matte twin and shadows of each picture; normals, depth,
albedo, gloss and mask of each view.

**Are there splits?** Yes; no two share: {", ".join(facts.by)}.{notes}

**Are there errors, noise or redundancies?** Layers add up to the picture to the rounding of the sample type; `degloss gen verify` checks
it in every pixel. Faults of a camera are in the pictures only where the plan asked for them.

**Does it hold anything confidential, offensive, or about people?** No. It shows rendered objects and nothing else.
"""


def _collection(facts: Facts) -> str:
    made = "; ".join(f"Blender {blender} on {device}, degloss {program}" for blender, device, program in facts.renderers)
    files = " Meshes or panoramas that specs name were brought by the creator." if facts.named_files else ""
    return f"""## Collection and preprocessing

**How was it acquired?** Rendered: {made}. Every value follows from the seed {facts.seed}.{files}

**Who was involved, and over what time?** Programs only. No person was asked, filmed or paid, and no data were taken from anywhere else.

**Was anything cleaned or labelled?** Pictures were screened for overexposure and divided into splits, both by rule. Files of pictures
are in the shards byte for byte as rendered; previews were added.
"""


def _rest(about: About, facts: Facts) -> str:
    where = f" It can be found at {about.url}." if about.url else ""
    families = "one family" if len(facts.shapes) == 1 else f"{len(facts.shapes)} families"
    return f"""## Uses

**What is it for?** Removing gloss, splitting pictures into layers, photometric stereo, and comparing such methods step by step.

**What should it not be used for?** As the only proof that a method works on photographs. Materials are analytic, shapes come from
{families}, light and camera are ideal: what holds here may fail on dust, scratches, reflections of a room, or a
camera's own processing.

**Is there a risk of harm?** No such risk is known.

## Distribution and maintenance

**Under which terms?** {about.terms.name} ({about.licence}, {about.terms.url}). {about.terms.terms}{where}

**Who keeps it up?** {about.creator}. Versions follow semantic versioning: another first number means other data under old names,
another second one more data, another third one corrected words. A version is never changed after it was given out; its manifests
would tell.

**Will it be updated?** Only as a new version. Older ones stay valid and can be rendered again from their plan.
"""
