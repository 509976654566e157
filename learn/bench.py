"""How fast a training is on this machine: pictures a second, the parts of a step, the share of the time that goes into the data.

    python -m learn.bench CONFIG [--steps N] [--device auto] [--data KEY=VALUE ...] [--json]

One device, the training's own step, timed part by part. The device is waited for after each part, so on a GPU the parts are honest and
their sum is a little more than a step of the training, which lets them overlap.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import torch

from gen.errors import InputError
from gen.files import dumps
from learn.config import Config, parse_overrides, read_config
from learn.ema import MovingAverage
from learn.fabric import Held, Objective, device_name, launch
from learn.method import create_method
from learn.train import make_optimiser

WARM_UP = 2
"""Steps before the clock starts: kernels are chosen and memory is taken in the first."""


@dataclass(frozen=True)
class Timing:
    """Means over the timed steps, in seconds a step. waiting_for_data: the share of a step that makes the batch.

    pictures: in a batch. parameters: of the network. peak_memory: bytes on the GPU, None on a CPU.
    """

    config: str
    device: str
    parameters: int
    steps: int
    pictures: int
    pictures_per_second: float
    waiting_for_data: float
    data: float
    forward: float
    backward: float
    update: float
    peak_memory: int | None


def bench(config: Config, steps: int = 10, device: str = "auto") -> Timing:
    """Time `steps` steps after `WARM_UP` more, without writing anything. Raises InputError as `learn.train.train` does."""
    if not 1 <= steps <= 1_000_000:
        raise InputError(f"--steps {steps} must lie from 1 to 1000000")
    options = config.train
    fabric = launch(device, options.precision)
    place: torch.device = fabric.device
    threads = torch.get_num_threads()
    if options.threads and place.type == "cpu":
        torch.set_num_threads(options.threads)
    try:
        method = create_method(config.method)
        source = method.source(config.data, options.batch, config.seed, place, "train")
        torch.manual_seed(config.seed)
        network = method.build(config.model).to(place).train()
        optimiser = make_optimiser(network, options)
        average = MovingAverage(network, options.ema) if options.ema else None
        objective, _ = fabric.setup(Objective(method, network), optimiser)
        spent = [0.0, 0.0, 0.0, 0.0]  # data, forward, backward, update
        for step in range(WARM_UP + steps):
            times = [_now(place)]
            batch = source.batch(step)
            times.append(_now(place))
            loss, _ = objective(Held(batch), step / (WARM_UP + steps))
            times.append(_now(place))
            optimiser.zero_grad(set_to_none=True)
            fabric.backward(loss)
            times.append(_now(place))
            if options.clip:
                torch.nn.utils.clip_grad_norm_(network.parameters(), options.clip)
            optimiser.step()
            if average:
                average.update(network, step)
            times.append(_now(place))
            if step >= WARM_UP:
                spent = [total + after - before for total, before, after in zip(spent, times, times[1:], strict=False)]
        name = device_name(place)
    finally:
        torch.set_num_threads(threads)
    data, forward, backward, update = (total / steps for total in spent)
    whole = data + forward + backward + update
    return Timing(
        config.name, name, sum(p.numel() for p in network.parameters()), steps, source.pictures, source.pictures / whole,
        data / whole, data, forward, backward, update,
        torch.cuda.max_memory_allocated(place) if place.type == "cuda" else None,
    )  # fmt: skip


def report(timing: Timing) -> str:
    """The figures as lines of text."""
    parts = ", ".join(f"{name} {1000 * getattr(timing, name):.1f}" for name in ("data", "forward", "backward", "update"))
    lines = [
        f"{timing.config} on {timing.device}: {timing.parameters / 1e6:.2f} M parameters, {timing.pictures} pictures a step",
        f"{timing.pictures_per_second:.4g} pictures/s, {timing.steps} steps; {timing.waiting_for_data:.1%} of the time waiting for data",
        f"milliseconds a step: {parts}",
    ]
    if timing.peak_memory is not None:
        lines.append(f"{timing.peak_memory / 1e9:.2f} GB of GPU memory at the most")
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """The plain command `python -m learn.bench`. Returns the exit code: 0, 2 for bad input, 130 after Ctrl-C."""
    parser = argparse.ArgumentParser(prog="python -m learn.bench", description="Time the steps of a training.")
    parser.add_argument("config", metavar="CONFIG", help="a TOML file, or the name of a shipped config")
    parser.add_argument("--steps", type=int, default=10, help="how many are timed")
    parser.add_argument("--device", default="auto", help="auto, cpu, cuda or cuda:1")
    parser.add_argument(
        "--data", metavar="KEY=VALUE", nargs="+", action="extend", default=[], help="values of the config's [data]"
    )
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    given = parser.parse_args(arguments)
    try:
        timing = bench(read_config(given.config, parse_overrides(given.data)), given.steps, given.device)
    except InputError as error:
        print(f"learn.bench: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("learn.bench: stopped", file=sys.stderr)
        return 130
    print(dumps(asdict(timing)) if given.json else report(timing))
    return 0


def _now(place: torch.device) -> float:
    if place.type == "cuda":
        torch.cuda.synchronize(place)
    return time.perf_counter()


if __name__ == "__main__":
    sys.exit(main())
