"""Training of any method by one loop, to be read from top to bottom.

On one CPU or GPU:      python -m learn.train CONFIG -o RUN
On the GPUs of a box:   torchrun --nproc-per-node 4 -m learn.train CONFIG -o RUN

A run is a folder: config.toml, log.csv, tb/, samples/, checkpoint.safetensors (to go on from), weights.safetensors (to use),
best.safetensors (the best by validation), summary.json. What happens in a step depends on the config and the step's number alone,
so a run that was stopped and resumed on a CPU ends with the same bits as one that was not.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import torch
from torch import Tensor, nn

from gen.errors import InputError
from gen.files import write_json
from learn.ahead import ahead
from learn.checkpoint import Parts, random_state, read_state, restore, write_checkpoint
from learn.config import Config, Train, determinants, parse_overrides, read_config, with_minutes
from learn.ema import MovingAverage
from learn.fabric import Held, Objective, agree, device_name, launch
from learn.interrupts import Interrupts, Mark, open_to_signals
from learn.logs import Board, CsvLog, Meters, Progress, write_png
from learn.method import create_method
from learn.run_folder import BEST, CHECKPOINT, LOG, SUMMARY, WEIGHTS, check_place, must_agree, open_run
from learn.schedule import rate_at, schedule_steps
from learn.validation import evaluating, validate
from learn.weights import load_weights, must_match, save_weights

AGREE_EVERY = 10
"""Steps between two looks of several processes at whether one of them was told to stop."""


@dataclass(frozen=True)
class Summary:
    """What a training did. steps: done, of the schedule's `of_steps`. stopped: "finished" or "clock".

    seconds, pictures, waiting_for_data (the share of the time that went into making batches): over all sessions of the run.
    loss: the mean since the last row of the log. validation_loss, best_validation_loss (at best_step): None without validation.
    """

    method: str
    config: str
    device: str
    processes: int
    steps: int
    of_steps: int
    stopped: str
    seconds: float
    pictures: int
    pictures_per_second: float
    waiting_for_data: float
    loss: float | None
    validation_loss: float | None
    best_validation_loss: float | None
    best_step: int | None
    weights: str


def train(config: Config, run: Path, resume: bool = False, device: str = "auto", progress: TextIO | None = sys.stderr) -> Summary:
    """Train a network as the config says into the folder `run`, or go on with the run that is there.

    device: "auto", "cpu", "cuda" or "cuda:1"; under torchrun every process takes its own. progress: where the line of progress goes.
    Raises InputError for a folder that is not free (or not a run of this config), a checkpoint that does not fit, bad data, and a
    loss that is not finite; KeyboardInterrupt, its text saying how to go on, after a signal, with a checkpoint written.
    """
    run, options = Path(run), config.train
    name = Path(config.name).name.removesuffix(".toml")
    fabric = launch(device, options.precision)
    place: torch.device = fabric.device
    rank, ranks = int(fabric.global_rank), int(fabric.world_size)
    if rank == 0:
        check_place(run, config, resume)

    with ExitStack() as stack:
        if options.threads and place.type == "cpu":
            stack.callback(torch.set_num_threads, torch.get_num_threads())
            torch.set_num_threads(options.threads)

        # The method, its data and its network; every process begins with the same weights.
        method = create_method(config.method)
        source = method.source(config.data, options.batch, config.seed, place, "train")
        checked = (
            method.source(config.data, options.batch, config.seed, place, "validation") if options.validate_every else source
        )
        total = schedule_steps(options, source, ranks)
        torch.manual_seed(config.seed)
        network = method.build(config.model).to(place).train()
        if options.start:
            start_from(network, config)
        optimiser = make_optimiser(network, options)
        average = MovingAverage(network, options.ema) if options.ema else None
        parts = Parts(network, optimiser, average.network if average else None, place)
        used = average.network if average else network
        objective, _ = fabric.setup(Objective(method, network), optimiser)

        # Where the run stands.
        step = seen = 0  # steps done; the last step whose figures, samples and checkpoint are done
        earlier = waited = 0.0  # seconds of earlier sessions; seconds that went into making batches
        figures: dict[str, float | None] = {"loss": None, "validation": None, "best": None, "best_step": None}
        meters = Meters()
        interrupts = stack.enter_context(Interrupts())
        if rank == 0:
            stack.enter_context(open_run(run, config, resume))
        fabric.barrier()
        if resume and (run / CHECKPOINT).is_file():
            state, tensors = read_state(run / CHECKPOINT)
            must_agree(run, state.get("config"), config)
            restore(run / CHECKPOINT, tensors, parts)
            del tensors
            try:
                step, seen = int(state["step"]), int(state["seen"])
                earlier, waited = float(state["seconds"]), float(state["waited"])
                figures = {key: None if state["figures"][key] is None else float(state["figures"][key]) for key in figures}
                meters = Meters.of(state["meters"], place)
            except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError) as error:
                raise InputError(f"{run / CHECKPOINT}: its state is damaged ({error!r:.80})") from error
            if not 0 <= seen <= step <= total:
                raise InputError(f"{run / CHECKPOINT}: says {step} steps of {total} are done; the file is damaged")
        if rank > 0:
            torch.manual_seed(config.seed + 1_000_003 * rank + step)  # the checkpoint holds the first process's generators
        begin, began = step, time.perf_counter()
        batches = stack.enter_context(ahead(source, options.prefetch))

        def seconds() -> float:
            return earlier + time.perf_counter() - began

        line = Progress(progress if rank == 0 else None)
        stack.callback(line.close)
        if rank == 0:
            log, board = CsvLog(run / LOG, seen), Board(run / "tb", seen)
            stack.callback(board.close)
            if board.note:
                line.say(board.note)

        def facts() -> dict[str, Any]:
            return {
                "config": name, "data": determinants(config)["data"], "seed": config.seed, "steps": step,
                "share_of_schedule": step / total, "seconds": round(seconds(), 1), "batch": options.batch * ranks,
                "pictures": step * ranks * source.pictures, "device": device_name(place), "processes": ranks,
                "precision": options.precision, "validation_loss": figures["validation"],
                "versions": {"python": platform.python_version(), "torch": torch.__version__, "numpy": np.__version__},
            }  # fmt: skip

        def save(random: Mapping[str, Tensor]) -> None:
            state = {
                "step": step, "seen": seen, "seconds": seconds(), "waited": waited, "figures": figures, "meters": meters.state(),
                "config": determinants(config),
            }  # fmt: skip
            write_checkpoint(run / CHECKPOINT, parts, state, random)
            save_weights(run / WEIGHTS, used, config.method, config.model, facts())

        # A signal may break in only where no other process waits for this one, and into a step only on a CPU, where it may last.
        may_break = interrupts.allowed if ranks == 1 else nullcontext
        step_may_break = interrupts.allowed if ranks == 1 and place.type == "cpu" else nullcontext
        if ranks == 1 and place.type == "cpu":
            open_to_signals(network)
        mark = Mark(network, place)
        count = sum(parameter.numel() for parameter in network.parameters())
        line.say(
            f"{config.method}: {count / 1e6:.3g} M parameters, {total} steps of {ranks * source.pictures} pictures on "
            f"{f'{ranks} times ' if ranks > 1 else ''}{device_name(place)}" + (f", going on after step {step}" if step else "")
        )
        try:
            while True:
                clock = options.minutes is not None and seconds() >= 60 * options.minutes
                told = interrupts.asked
                if ranks > 1:
                    told, clock = agree(fabric, told, clock) if step % AGREE_EVERY == 0 else (False, False)
                if told:
                    raise KeyboardInterrupt
                over = step >= total or clock

                # What is due after `step` steps: validation, a row of the log, samples, a checkpoint.
                if rank == 0 and step > seen:
                    validates = options.validate_every > 0 and (step % options.validate_every == 0 or over)
                    row: dict[str, float] = {}
                    if validates:
                        with may_break():
                            found = validate(method, used, checked, options.validation_batches, place)
                        row = {f"validation_{name}": value for name, value in found.items()}
                        figures["validation"] = found["loss"]
                        if np.isfinite(found["loss"]) and (figures["best"] is None or found["loss"] < figures["best"]):
                            figures["best"], figures["best_step"] = found["loss"], step
                            save_weights(run / BEST, used, config.method, config.model, facts())
                    if options.sample_every and (step % options.sample_every == 0 or over):
                        with may_break(), torch.no_grad(), evaluating(used, place):
                            sheet = method.samples(used, checked.batch(0))
                        write_png(run / "samples" / f"step_{step:06d}.png", sheet)
                        board.picture(sheet, step)
                    if validates or step % options.log_every == 0 or over:
                        means = meters.means()
                        if not all(np.isfinite(value) for value in means.values()):
                            bad = next(name for name, value in means.items() if not np.isfinite(value))
                            raise InputError(
                                f"{run}: {bad} is not finite within the last {meters.count} steps before step {step}: the training has "
                                f"diverged; lower train.rate or set train.clip, and begin a new run"
                            )
                        figures["loss"] = means.get("loss", figures["loss"])
                        speed = (step - begin) * ranks * source.pictures / max(seconds() - earlier, 1e-9)
                        spent = {
                            "seconds": seconds(),
                            "pictures_per_second": speed,
                            "waiting_for_data": waited / max(seconds(), 1e-9),
                        }
                        row = {"step": step, **spent, "rate": rate_at(options, step - 1, total), **means, **row}
                        log.write(row)
                        board.write(row)
                        meters = Meters()
                    seen = step
                    if step % options.checkpoint_every == 0 or over:
                        save(random_state(place))
                if over:
                    break

                # One step.
                if place.type == "cpu":
                    mark.set()
                with step_may_break():
                    start = time.perf_counter()
                    batch = batches(step * ranks + rank, (step + 1) * ranks + rank if step + 1 < total else None)
                    spent_waiting = time.perf_counter() - start
                    loss, extra = objective(Held(batch), step / total)
                    optimiser.zero_grad(set_to_none=True)
                    fabric.backward(loss)
                for group in optimiser.param_groups:
                    group["lr"] = rate_at(options, step, total)
                taken = {"loss": loss, **extra}
                if options.clip:
                    taken["gradient_norm"] = nn.utils.clip_grad_norm_(network.parameters(), options.clip)
                optimiser.step()
                if average:
                    average.update(network, step)
                meters.add(taken)
                waited += spent_waiting
                step += 1
                mark.clear()

                done, elapsed = step - begin, max(seconds() - earlier, 1e-9)
                left = (total - step) * elapsed / done
                if options.minutes is not None:
                    left = min(left, 60 * options.minutes - seconds())
                line.show(step, total, done * ranks * source.pictures / elapsed, left, figures["loss"])
        except BaseException:
            if not interrupts.asked:  # where a signal came, whatever it broke may have failed in its own way
                raise
            if rank == 0:
                save(mark.undo())
            again = f"stopped after step {step} of {total}; go on with: {resume_command(config, run, device)}"
            raise KeyboardInterrupt(again) from None

        elapsed = max(seconds(), 1e-9)
        summary = Summary(
            config.method, name, device_name(place), ranks, step, total, "finished" if step >= total else "clock",
            round(elapsed, 3), step * ranks * source.pictures, step * ranks * source.pictures / elapsed, waited / elapsed,
            figures["loss"], figures["validation"], figures["best"],
            None if figures["best_step"] is None else int(figures["best_step"]), str(run / WEIGHTS),
        )  # fmt: skip
        if rank == 0:
            write_json(run / SUMMARY, asdict(summary))
        return summary


def make_optimiser(network: nn.Module, options: Train) -> torch.optim.Optimizer:
    """Adam or AdamW. Weight decay is for matrices and kernels alone, not for biases and the scales of norms."""
    parameters = [p for p in network.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in parameters if p.ndim >= 2], "weight_decay": options.weight_decay},
        {"params": [p for p in parameters if p.ndim < 2], "weight_decay": 0.0},
    ]
    kind = {"adam": torch.optim.Adam, "adamw": torch.optim.AdamW}[options.optimiser]
    return kind([group for group in groups if group["params"]], lr=options.rate)


def start_from(network: nn.Module, config: Config) -> None:
    """Give a new network the weights that the config's train.start names. Raises InputError where they are of another network."""
    loaded = load_weights(config.train.start or config.method)
    expected, given = network.state_dict(), loaded.model.state_dict()
    must_match(given, expected, f"{loaded.path}: train.start: the network of {config.name} is another one")
    network.load_state_dict(given)


def resume_command(config: Config, run: Path, device: str) -> str:
    """The command that goes on with a run, for a shell."""
    words = ["degloss", "learn", "train", config.name, "-o", str(run), "--resume"]
    words += [] if device == "auto" else ["--device", device]
    for key in config.overridden:
        value = config.data[key]
        plain = f"{key}={value}"
        words += ["--data", plain if parse_overrides([plain])[key] == value else f"{key}={json.dumps(value)}"]
    return shlex.join(words)


def main(arguments: Sequence[str] | None = None) -> int:
    """The plain command `python -m learn.train`. Returns the exit code: 0, 2 for bad input, 130 after a signal."""
    parser = argparse.ArgumentParser(prog="python -m learn.train", description="Train a network of gloss removal.")
    parser.add_argument("config", metavar="CONFIG", help="a TOML file, or the name of a shipped config")
    parser.add_argument("-o", "--output", metavar="RUN", type=Path, required=True, help="the folder of the run")
    parser.add_argument("--resume", action="store_true", help="go on with the run that is there")
    parser.add_argument("--device", default="auto", help="auto, cpu, cuda or cuda:1")
    parser.add_argument(
        "--data", metavar="KEY=VALUE", nargs="+", action="extend", default=[], help="values of the config's [data]"
    )
    parser.add_argument("--minutes", type=float, help="stop by the clock, all sessions of the run together")
    given = parser.parse_args(arguments)
    try:
        config = with_minutes(read_config(given.config, parse_overrides(given.data)), given.minutes)
        summary = train(config, given.output, given.resume, given.device)
    except InputError as error:
        print(f"learn.train: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as error:
        print(f"learn.train: {error or 'stopped before the first step'}", file=sys.stderr)
        return 130
    if int(os.environ.get("RANK", "0")) == 0:
        print(
            f"{summary.steps} of {summary.of_steps} steps in {summary.seconds:.0f} s, loss {summary.loss or float('nan'):.4g}, "
            f"validation {summary.validation_loss or float('nan'):.4g}: {summary.weights}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
