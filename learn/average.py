"""The mean of trained networks: `python -m learn.average WEIGHTS WEIGHTS... -o OUT.safetensors`.

Of a training and what it went on to from there, the mean is often better than either: it keeps what the further training would forget.
Source: M. Wortsman et al., "Model soups: averaging weights of multiple fine-tuned models improves accuracy without increasing inference
time", ICML 2022.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from gen.errors import InputError
from learn.weights import load_weights, save_weights


def average(sources: Sequence[str | Path], out: Path) -> None:
    """Write the mean of the weights of several files, folders of trainings, or names of shipped weights, all of one network.

    The facts are those of the last, with `mean_of`, the configs of all. What is no number with a fraction (a counter) is the last one's.
    Raises MissingPart without torch; InputError where there are fewer than two, one cannot be read, or they are not of one network.
    """
    if len(sources) < 2:
        raise InputError("give two or more weights: the mean of one is itself")
    loaded = [load_weights(source) for source in sources]
    last = loaded[-1]
    for other in loaded[:-1]:
        if (other.method, dict(other.options)) != (last.method, dict(last.options)):
            raise InputError(f"{other.path}: is not the same network as {last.path}")
    states = [one.model.state_dict() for one in loaded]
    mean = {
        name: sum(state[name].double() for state in states).div(len(states)).to(value.dtype)
        if value.is_floating_point()
        else value
        for name, value in states[-1].items()
    }
    last.model.load_state_dict(mean)
    configs = [one.facts.get("config") for one in loaded]
    save_weights(out, last.model, last.method, last.options, {**last.facts, "mean_of": configs})


def main(arguments: Sequence[str] | None = None) -> None:
    """Read, average and write."""
    parser = argparse.ArgumentParser(prog="python -m learn.average", description=__doc__)
    parser.add_argument("weights", nargs="+", help="weight files, folders of trainings, or names of shipped weights")
    parser.add_argument("-o", "--out", type=Path, required=True, help="the file to write")
    given = parser.parse_args(arguments)
    try:
        average(given.weights, given.out)
    except InputError as error:
        print(f"learn.average: {error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
