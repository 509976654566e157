"""The card, README.md: front matter by which Hugging Face shows and loads a release, and what a reader has to know.

The code in it is meant to be run as it stands, inside the folder of the release; the tests take it out of a card and do so.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from gen.release.about import About
from gen.release.facts import LAYERS, Facts
from gen.release.layout import SHEET
from gen.release.yaml_text import yaml_text

SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
TAGS = (
    "photometric-stereo",
    "gloss-removal",
    "specular-highlight-removal",
    "intrinsic-image-decomposition",
    "synthetic",
    "webdataset",
)

LATEX = str.maketrans(
    {
        "\\": r"{\textbackslash}",
        "{": r"{\textbraceleft}",
        "}": r"{\textbraceright}",
        "~": r"{\textasciitilde}",
        "^": r"{\textasciicircum}",
        **{character: f"\\{character}" for character in "&%#_$"},
    }
)
"""Characters that LaTeX reads as commands, as it prints them. BibTeX counts braces, escaped or not, so they are spelt out."""

URL = str.maketrans({"{": "%7B", "}": "%7D", "\\": "%5C"})


def card(about: About, facts: Facts) -> str:
    """The text of README.md."""
    parts = (
        f"---\n{yaml_text(front_matter(about, facts))}---\n",
        f"# {about.title}\n\n{about.description}\n\nVersion {about.version}. "
        "All pictures are rendered; their truth comes from the renderer, it is not estimated.\n",
        f"![Captures of this data set, drawn at random: picture, layers, normals]({SHEET})\n",
        _contents(about, facts),
        _loading(facts),
        _format(facts),
        CONVENTIONS,
        _making(facts),
        USES,
        CHECKING,
        _rights(about, facts),
    )
    return "\n".join(parts)


def front_matter(about: About, facts: Facts) -> dict[str, Any]:
    """The metadata of a card: licence, tags, and which files are which split."""
    return {
        "license": about.terms.hub,
        "pretty_name": about.title,
        "task_categories": ["image-to-image", "depth-estimation"],
        "size_categories": [next((name for limit, name in SIZES if facts.pictures < limit), "1M<n<10M")],
        "annotations_creators": ["machine-generated"],
        "source_datasets": ["original"],
        "tags": list(TAGS),
        "configs": configs(facts),
    }


def configs(facts: Facts) -> list[dict[str, Any]]:
    """One config for each number of pictures a capture has, since all samples of a config must have the same fields."""
    most = max(facts.kinds, key=lambda kind: facts.kinds[kind])
    found = []
    for kind in facts.kinds:
        files = [
            {"split": split, "path": [f"data/{name}" for name, of, pictures in facts.shards if (of, pictures) == (split, kind)]}
            for split in facts.splits
        ]
        named = "default" if len(facts.kinds) == 1 else f"{kind}-picture{'s' * (kind > 1)}"
        chosen = {"default": True} if len(facts.kinds) > 1 and kind == most else {}
        found.append({"config_name": named, **chosen, "data_files": [entry for entry in files if entry["path"]]})
    return found


def first_shard(facts: Facts) -> tuple[str, str]:
    """(file, split) of the shard that the examples read: the first of the default config."""
    most = max(facts.kinds, key=lambda kind: facts.kinds[kind])
    return next((name, split) for name, split, pictures in facts.shards if pictures == most)


def _contents(about: About, facts: Facts) -> str:
    lines = ["## What is in it", "", "| split | captures | pictures |", "|---|---|---|"]
    lines += [f"| {name} | {items:,} | {pictures:,} |" for name, (items, pictures) in facts.splits.items()]
    low, high = facts.alpha
    sizes = ", ".join(f"{w}x{h}" for w, h in facts.sizes)
    gloss = f"alpha {low:.3g}" if low == high else f"alpha {low:.3g} to {high:.3g}"
    apart = f"No two splits share {_words(facts.by)}" + (f"; but {'; '.join(facts.notes)}" if facts.notes else "")
    left = ", ".join(f"{n:,} ({reason})" for reason, n in facts.rejected.items())
    out = f"Pictures left out: {left}; `data/rejected.parquet` names each" if left else "No picture was left out"
    lines += [
        "",
        "A capture is a set of pictures of one object from one fixed view, each under one light (or, where it says so, under several).",
        "",
        f"- Pictures a capture: {_counts(facts.kinds)}. Size: {sizes} pixels.",
        f"- Shapes: {_counts(facts.shapes)}.",
        f"- Materials: {_counts(facts.materials)}; gloss: {gloss}.",
        f"- Light: {', '.join(facts.lights)}.",
        f"- {apart}.",
        f"- {out}.",
        "",
    ]
    return "\n".join(lines)


def _loading(facts: Facts) -> str:
    shard, split = first_shard(facts)
    return f"""## Load it

Inside the folder of the release. With Hugging Face's `datasets`:

```python
import os
from datasets import load_dataset

capture = next(iter(load_dataset(os.getcwd(), split="{split}", streaming=True)))
print(capture["__key__"], capture["json"]["directions"], capture["preview.png"].size)
```

With `webdataset` (`WDS_SECURE` before the import: no pickles are read and no commands run):

```python
import os; os.environ["WDS_SECURE"] = "1"
import webdataset as wds

for capture in wds.WebDataset("data/{shard}", shardshuffle=False).decode():
    print(capture["__key__"], capture["json"]["alpha"], len(capture["001.exr"]))
```

One picture with all its layers, by the index and plain OpenEXR (`pip install OpenEXR pyarrow`):

```python
import io, numpy, OpenEXR, pyarrow.parquet
row = pyarrow.parquet.read_table("data/pictures.parquet").slice(0, 1).to_pylist()[0]
data = numpy.fromfile("data/" + row["shard"], numpy.uint8, row["bytes"], offset=row["offset"]).tobytes()
channels = OpenEXR.File(io.BytesIO(data), separate_channels=True).channels()
print(row["item"], row["picture"], sorted(channels), channels["matte.R"].pixels.shape)
```

As a Capture of degloss, whole and with its truth as arrays:

```python
from gen.release.reading import open_release
release = open_release(".")
capture = release.capture(release.items("{split}")[0])
print(capture.images.shape, capture.lights[0], capture.truth.names())
```
"""


def _format(facts: Facts) -> str:
    def channels(found: Mapping[str, str]) -> str:
        return "\n".join(f"  - `{_named(name, found)}` ({found[name]}): {text}" for name, text in LAYERS.items() if name in found)

    box = (
        """
EXRs store the box around the object only, as their data window; the display window is the whole frame. Outside the box each channel
has one value, which the header's attribute `outside` names (JSON). degloss fills it in.
"""
        if facts.cropped
        else ""
    )
    return f"""## Format

A capture is one WebDataset sample in a tar file. Its key is the capture's name, its fields:

- `json`: split, lights (`directions`, `intensities`), gloss (`alpha`, least and largest), shape, material, seed, and hashes by which splits
  were kept apart. The same keys in every sample.
- `001.exr`, `002.exr`, ...: one layered OpenEXR a picture:
{channels(facts.frame)}
- `view.exr`: what holds for all pictures of the capture:
{channels(facts.view)}
- `mask.png`: white on the object. `preview.png`: a small sRGB picture for people.
- `capture`: the JSON index of the capture with its whole spec, as degloss reads it.
{box}
Tables (Parquet) in `data`: `pictures` (every picture with its place in the shards, hash, gloss and light), `rejected` (every picture that
was left out, with the reason), `members` (every file in every shard: offset, size, SHA-256). `plan.jsonl` holds every value of every
capture, `splits.json` the division. `load_dataset("parquet", data_files="data/pictures.parquet")` loads a table.
"""


CONVENTIONS = """## Conventions

- Radiance is linear, Rec.709 primaries. picture = diffuse + specular, to the rounding of the sample type.
- Frame: x to the right, y up, z out of the picture to the camera, right-handed. Directions are unit vectors from the object to the light.
- Intensity of a light: radiance of a white Lambertian surface that faces it. So `matte = albedo * intensity * max(n.l, 0)` where one
  distant light reaches.
- Rows run from top to bottom. Normals are zero outside the mask.
- The diffuse layer of a glossy material is not Lambertian: coats take light away at grazing angles. The matte twin is Lambertian.
"""

USES = """## What it is for, and what not

For training and judging methods that remove gloss, split pictures into layers, or measure shape from pictures under known lights
(photometric stereo). The truth lets each step be judged: layers, normals, depth, albedo, gloss.

The pictures are rendered. They show analytic materials and clean shapes in front of nothing, without noise, lens blur, dust or
background unless the plan says so. A method that does well here has yet to be tried on photographs. The data say nothing about people.
"""

CHECKING = """## Check it

```
sha256sum -c --quiet manifest-sha256.txt tagmanifest-sha256.txt     # every byte; the folder is a BagIt bag
degloss gen verify .                                                # every byte, the tables against the shards, the layers' identities
```
"""


def _making(facts: Facts) -> str:
    made = "; ".join(f"Blender {blender} (Cycles) on {device}" for blender, device, _ in facts.renderers)
    files = " (bring the files that its specs name)" if facts.named_files else ""
    return f"""## How it was made

Rendered by degloss with headless Blender: {made}. Every value was drawn from the seed {facts.seed}. `data/plan.jsonl` holds
all of them, and `degloss gen render data/plan.jsonl -o SET` renders the set again{files}. `provenance.json` holds versions and
hashes, `DATASHEET.md` answers the questions of *Datasheets for Datasets* (Gebru and others, 2021), `croissant.json` is for machines.
"""


def _rights(about: About, facts: Facts) -> str:
    theirs = (
        "\n\nSome captures show meshes or panoramas that the creator of this data set brought. Their authors' terms may ask for more."
        if facts.named_files
        else ""
    )
    return f"""## Licence and citation

{about.terms.name} ([{about.licence}]({about.terms.url})). {about.terms.terms}{theirs}

```bibtex
{bibtex(about)}
```
"""


def bibtex(about: About) -> str:
    """The data set as a BibTeX entry."""
    title, creator = about.title.translate(LATEX), about.creator.translate(LATEX)
    lines = [f"  title = {{{title}}}", f"  author = {{{{{creator}}}}}", f"  version = {{{about.version}}}"]
    lines += [f"  year = {{{about.date[:4]}}}"] if about.date else []
    lines += [f"  url = {{{about.url.translate(URL)}}}"] if about.url else []
    return f"@misc{{{about.name},\n" + ",\n".join(lines) + "\n}"


def _named(first: str, found: Mapping[str, str]) -> str:
    """The channels of a layer as one word: diffuse.{R,G,B}."""
    if first == "R":
        return "R G B A"
    layer, _, letter = first.partition(".")
    letters = [name.removeprefix(f"{layer}.") for name in found if name.startswith(f"{layer}.")]
    order = "RGB" if letter == "R" else "XYZ" if letter == "X" else "".join(sorted(letters))
    return first if len(letters) == 1 else f"{layer}.{{{','.join(order)}}}"


def _counts(counts: Mapping[Any, int]) -> str:
    return (
        ", ".join(str(name) for name in counts)
        if len(counts) == 1
        else ", ".join(f"{name} ({n:,})" for name, n in counts.items())
    )


def _words(names: tuple[str, ...]) -> str:
    words = {"object": "an object", "material": "a material", "lights": "a set of lights"}
    found = [words[name] for name in names]
    return found[0] if len(found) == 1 else f"{', '.join(found[:-1])} or {found[-1]}"
