"""The folder of one training: whose it is, that nobody else writes there, and what a killed process left."""

from __future__ import annotations

import fcntl
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gen.errors import InputError
from gen.files import writing
from learn.config import Config, determinants, difference, parse_config

CHECKPOINT = "checkpoint.safetensors"
WEIGHTS = "weights.safetensors"
BEST = "best.safetensors"
CONFIG = "config.toml"
LOG = "log.csv"
SUMMARY = "summary.json"

LEFT = re.compile(r"\..+\.\d+\.tmp(\.\w+)?")
"""A temporary name of `gen.files.writing`."""


def check_place(run: Path, config: Config, resume: bool) -> None:
    """Raise InputError unless `run` is free (or, to resume, a run that this config began). Writes nothing.

    A run without a checkpoint, killed before its first, is compared by its config.toml; the checkpoint is compared where it is read.
    """
    try:
        there = run.is_dir()
        if not there and (run.exists() or run.is_symlink()):
            raise InputError(f"{run}: is a file; a training needs a folder: choose another with -o")
        if not resume:
            if there and any(path.name != ".lock" for path in run.iterdir()):
                raise InputError(f"{run}: is there already; go on with it by --resume, or choose another folder with -o")
            return
        if not there or not (run / CONFIG).is_file():
            raise InputError(f"{run}: there is no run to resume (no {CONFIG}); leave out --resume")
        text = (run / CONFIG).read_text(encoding="utf-8")
    except OSError as error:
        raise InputError(f"{run}: cannot be read ({error.strerror or error})") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{run / CONFIG}: is not UTF-8 text; this is no run of ours") from error
    began = parse_config(text, str(run / CONFIG), {key: config.data[key] for key in config.overridden})
    if not (run / CHECKPOINT).is_file():
        must_agree(run, determinants(began), config)


def must_agree(run: Path, there: object, config: Config) -> None:
    """Raise InputError, naming the first key, where a run began with `determinants` other than the config's."""
    differs = difference(there, determinants(config))
    if differs:
        raise InputError(f"{run}: was begun with another config ({differs}); resume it with its own, or begin a new run with -o")


@contextmanager
def open_run(run: Path, config: Config, resume: bool) -> Iterator[None]:
    """Make or enter the folder and hold it for this process; keeps a copy of the config and removes left-over temporary files.

    Raises InputError as `check_place` does, and where another training holds the folder or it cannot be written.
    """
    try:
        run.mkdir(parents=True, exist_ok=True)
        lock = (run / ".lock").open("w")
    except OSError as error:
        raise InputError(f"{run}: cannot be written ({error.strerror or error}); choose another folder with -o") from error
    with lock:  # the system lets go of it even when the process is killed
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise InputError(
                f"{run}: another training is writing there; wait for it, or choose another folder with -o"
            ) from error
        except OSError:
            pass  # a file system without locks
        check_place(run, config, resume)
        for folder in (run, run / "samples"):
            for left in folder.iterdir() if folder.is_dir() else ():
                if LEFT.fullmatch(left.name) and left.is_file():
                    left.unlink()
        with writing(run / CONFIG) as temporary:
            temporary.write_text(config.text, encoding="utf-8")
        yield
