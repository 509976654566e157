"""The commands `degloss learn ...`. Nothing heavy is imported before a command runs, so that help is fast."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import App, Parameter

Flag = Annotated[bool, Parameter(negative=(), show_default=False)]
Output = Annotated[Path, Parameter(name=["--output", "-o"])]
MaybeOutput = Annotated[Path | None, Parameter(name=["--output", "-o"])]

app = App(name="learn", help="The networks that remove gloss: train, evaluate, apply, export.", help_format="plaintext")


@app.command
def train(
    config: str,
    /,
    *,
    output: Output,
    resume: Flag = False,
    device: str = "auto",
    data: Annotated[tuple[str, ...], Parameter(consume_multiple=True, negative=())] = (),
    minutes: float | None = None,
    json: Flag = False,
) -> None:
    """Train a network as a config says.

    The folder of the run holds the config, log.csv, tb/ for TensorBoard, samples/, the checkpoint to go on from, and
    weights.safetensors, which every other command takes. An interrupt leaves a checkpoint behind. On a machine without this command,
    python -m learn.train does the same; on several GPUs, torchrun --nproc-per-node N -m learn.train.

    Parameters
    ----------
    config
        A TOML file, or the name of a shipped config (see degloss learn methods).
    output
        The folder of the run.
    resume
        Go on with the run that is there.
    device
        What to compute on: auto, cpu, cuda or cuda:NUMBER.
    data
        Values of the config's [data] as KEY=VALUE, such as pack=sets/train.safetensors.
    minutes
        Stop by the clock, all sessions of the run together; the schedule stays as long as it is.
    json
        Print one JSON object on stdout in place of a sentence.
    """
    from dataclasses import asdict

    from gen.files import dumps
    from gen.parts import import_whole, require
    from learn.config import parse_overrides, read_config, with_minutes

    wanted = with_minutes(read_config(config, parse_overrides(data)), minutes)
    require("torch")  # fabric has two names; the training itself says where neither is there
    import_whole("torch")
    from learn.train import train as run_training

    summary = run_training(wanted, output, resume, device)
    if json:
        print(dumps(asdict(summary)))
        return
    print(f"{summary.weights}: {summary.steps} of {summary.of_steps} steps in {summary.seconds:.0f} s, {summary.stopped}")


@app.command(name="eval")
def evaluate(
    weights: str,
    data: Path,
    /,
    *,
    split: Literal["train", "validation", "test", "all"] | None = None,
    limit: int | None = None,
    measure: Annotated[bool, Parameter(negative="--no-measure")] = True,
    repair: str = "telea",
    seed: int = 0,
    device: str = "auto",
    output: MaybeOutput = None,
    json: Flag = False,
) -> None:
    """Score weights on pictures with truth: errors of the pictures by slice, and what they are worth to the measurement.

    Beside the network stand the pictures as they are, the classical removers, and, where a view has three lights or more, the true
    diffuse and matte layers: the ceilings. Gap closed is (glossy - method) / (glossy - matte) of the mean angles to the true
    normals, over all captures together, with a 95 % interval (paired bootstrap).

    Parameters
    ----------
    weights
        A file, the folder of a run, or a method whose shipped weights are meant: lime, specular, diffuse, group.
    data
        A pack (degloss gen pack), a set folder, or a capture folder with its truth.
    split
        Which items of divided data. Default: test where there is one.
    limit
        At most so many captures, evenly spaced.
    measure
        Whether captures of three lights and more are measured.
    repair
        The repair that each method is measured with besides none (see degloss recon methods).
    seed
        Of the bootstrap.
    device
        What to compute on: auto, cpu, cuda or cuda:NUMBER.
    output
        A folder for results.json, report.html and a sheet of pictures; an earlier result there is replaced.
    json
        Print one JSON object on stdout in place of tables.
    """
    from gen.files import dumps, keep_apart, write_json, writing_folder
    from gen.images import write_png
    from learn.weights import load_weights
    from recon.reconstruct import Settings

    settings = Settings(gloss="none", repair=repair)
    loaded = load_weights(weights, device)
    if output is not None:
        keep_apart(data, output)

    from functools import partial

    from learn.evaluate import evaluate as run_evaluation
    from learn.evaluation_table import text_of
    from learn.removers import remove_by
    from learn.report import evaluation_page
    from learn.slices import scenes_of
    from recon.page import write_report

    scenes = scenes_of(data, split, limit)
    with _progress("captures") as bar:
        done = run_evaluation({loaded.method: partial(remove_by, loaded)}, scenes, settings, seed, measure, bar("scoring"))
    said = {"weights": str(loaded.path), "method": loaded.method, "data": scenes.name, "split": scenes.split, "seed": seed}
    result = {**said, **done.plain()}
    if output is not None:
        with writing_folder(output, "evaluation") as folder:
            write_json(folder / "results.json", result)
            write_report(folder, lambda: evaluation_page(loaded.method, scenes.name, done))
            if done.lines:
                write_png(folder / "pictures.png", done.sheet())
    print(dumps(result) if json else f"{loaded.method} on {scenes.name}: {text_of(done)}")


@app.command
def predict(
    weights: str,
    /,
    *images: Path,
    output: Output,
    mask: Path | None = None,
    lights: Path | None = None,
    encoding: Literal["srgb", "linear"] | None = None,
    device: str = "auto",
    json: Flag = False,
) -> None:
    """Remove the gloss from pictures, without lights or a capture folder.

    Each picture gives NAME-diffuse and NAME-specular: PNG of as many bits as it has, encoded as it was read, or EXR for floats. The
    group network takes all pictures as one view under several lights, and gives NAME-matte and NAME-confidence besides.

    Parameters
    ----------
    weights
        A file, the folder of a run, or a method whose shipped weights are meant: lime, specular, diffuse, group.
    images
        PNG, JPEG, TIFF or EXR, 8x8 pixels or more.
    output
        The folder to write; an earlier result there is replaced.
    mask
        A picture, white on the object, for all of them. Default: the whole frame is the object.
    lights
        For the group network: a file with a row x y z for each picture, from the object to the light.
    encoding
        How the files' numbers are meant. Default: 8-bit is sRGB, 16-bit and EXR are linear.
    device
        What to compute on: auto, cpu, cuda or cuda:NUMBER.
    json
        Print one JSON object on stdout in place of sentences.
    """
    from dataclasses import asdict

    from gen.files import dumps
    from learn.predict import predict as run_prediction
    from learn.weights import load_weights

    loaded = load_weights(weights, device)
    with _progress("pictures") as bar:
        made = run_prediction(loaded, images, output, mask, lights, encoding, bar("removing the gloss"))
    if json:
        print(dumps({"folder": str(output), "method": loaded.method, "pictures": [asdict(one) for one in made]}))
        return
    for one in made:
        clipped = f"; {100 * one.clipped:.1f} % clipped" if one.clipped >= 0.001 else ""
        print(f"{one.source}: {one.size[1]}x{one.size[0]}, read as {one.encoding}{clipped}: {', '.join(one.files.values())}")


@app.command
def export(
    weights: str,
    /,
    *,
    output: Output,
    format: Literal["onnx", "torch"] = "onnx",
    pictures: int = 5,
    shrink: int = 1,
    json: Flag = False,
) -> None:
    """Write a network for other programs, and compare the file with the network before it is kept.

    onnx: for onnxruntime and others. torch: TorchScript, for torch.jit.load and libtorch. Batch, height and width are free. In and out
    is linear radiance; the networks of single pictures expect an exposure in which the object's 95th percentile of luma is .8.

    Parameters
    ----------
    weights
        A file, the folder of a run, or a method whose shipped weights are meant: lime, specular, diffuse, group.
    output
        The file to write.
    format
        onnx or torch.
    pictures
        Of the group network: how many pictures of a view the file is for.
    shrink
        Of the group network: its trunk looks at means of this many pixels a side. Measuring takes the pixels across the object over 64.
    json
        Print one JSON object on stdout in place of a sentence.
    """
    from gen.errors import InputError
    from gen.files import dumps
    from gen.parts import require
    from learn.weights import load_weights

    if format == "onnx":
        require("export")
    loaded = load_weights(weights)
    if output.exists() and output.resolve() == loaded.path.resolve():
        raise InputError(f"{output}: these are the weights themselves; choose another place with -o")
    from learn.export import export_model

    facts = {
        "degloss.method": loaded.method,
        "degloss.options": dumps(dict(loaded.options)),
        "degloss.facts": dumps(dict(loaded.facts)),
    }
    done = export_model(loaded.model, output, format, pictures, facts, shrink)
    if json:
        print(dumps({"file": str(output), "method": loaded.method, **done}))
        return
    print(f"{output}: {done['bytes'] / 1e6:.1f} MB, within {done['difference']['most']:.1g} of the network")


@app.command
def table1(
    *,
    learning: Path | None = None,
    test: Path | None = None,
    lime: str = "lime",
    specular: str = "specular",
    diffuse: str = "diffuse",
    group: str = "group",
    limit: int | None = 200,
    workers: int = 1,
    device: str = "auto",
    output: MaybeOutput = None,
    json: Flag = False,
) -> None:
    """Work out the paper's Table 1: the error of the methods (a) to (d) on learning and test data, and the pictures of its Fig. 3.3.

    Mean squared error on 8-bit values over the full frame, as in the paper, and inside the mask; beside the methods the pictures as
    they are, the classical removers, and the figures that the paper prints, which are of other data.

    Parameters
    ----------
    learning
        A pack or set with the learning data. Without this and --test, the preset paper-train is rendered with Blender.
    test
        A pack or set with the test data.
    lime
        Weights of method (a); by default the shipped ones.
    specular
        Weights of method (b).
    diffuse
        Weights of method (c).
    group
        Weights of method (d), which is given one picture at a time here.
    limit
        Learning pictures to score, evenly spaced; 0 takes all.
    workers
        Blender processes.
    device
        What to compute on: auto, cpu, cuda or cuda:NUMBER.
    output
        A folder for results.json, report.html and table1.png; an earlier result there is replaced.
    json
        Print one JSON object on stdout in place of the table.
    """
    from gen.errors import InputError
    from gen.files import dumps, keep_apart, write_json, writing_folder
    from gen.images import write_png
    from gen.parts import require

    require("torch")
    if limit is not None and limit < 0:
        raise InputError(f"--limit {limit}: must be at least 1, or 0 for all")
    from learn.removers import remover
    from learn.report import table1_page
    from learn.table1 import table1 as run_table
    from recon.page import write_report

    chosen = {"lime": lime, "specular": specular, "diffuse": diffuse, "group": group}
    removers = {name: remover(name, given, device) for name, given in chosen.items()}
    for place in (learning, test):
        if output is not None and place is not None:
            keep_apart(place, output)
    with _progress("pictures") as bar:
        done = run_table(removers, learning, test, limit or None, workers, lambda title, at, total: bar(title)(at, total))
    if output is not None:
        with writing_folder(output, "table") as folder:
            write_json(folder / "results.json", done.plain())
            write_report(folder, lambda: table1_page(done))
            write_png(folder / "table1.png", done.figure())
    print(dumps(done.plain()) if json else done.text())


@app.command
def methods(*, json: Flag = False) -> None:
    """List the learned methods, each with its source, and the configs that are shipped for them.

    Parameters
    ----------
    json
        Print one JSON object on stdout.
    """
    from gen.files import dumps
    from learn.config import config_names
    from learn.method import METHODS
    from recon.registry import GLOSS

    known = GLOSS.describe()
    names = config_names()
    table = {name: {"what": known[name][0], "source": known[name][1]} for name in METHODS}
    if json:
        print(dumps({"methods": table, "configs": names}))
        return
    for name, row in table.items():
        print(f"{name:<10} {row['what']}")
    print(f"configs: {', '.join(names)}")


@app.command
def weights(*, json: Flag = False) -> None:
    """List the shipped weights with the facts of their training; the model cards lie beside them.

    Parameters
    ----------
    json
        Print one JSON object on stdout.
    """
    from gen.files import dumps
    from learn.shipped import shipped_weights

    table = shipped_weights()
    if json:
        print(dumps(table))
        return
    for name, row in table.items():
        facts = ", ".join(f"{key} {value}" for key, value in row["facts"].items() if isinstance(value, str | int | float))
        print(f"{name:<10} {row['bytes'] / 1e6:.1f} MB, {row['file']}\n{'':<10} {facts or 'no facts'}")
    if not table:
        print("no weights are shipped with this installation; degloss learn train makes them")


@contextmanager
def _progress(unit: str) -> Iterator[Callable[[str], Callable[[int, int], None]]]:
    """A progress bar on stderr with the time left, where that is a terminal; otherwise nothing is shown.

    unit: what is counted. Handed out is a function from a title to one that is called with (done, in all).
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn(unit), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("starting", total=None)
        yield lambda title: lambda done, total: bar.update(task, description=title, completed=done, total=total)
