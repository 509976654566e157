"""The front door: one command, `degloss`, which mounts gen, recon and learn. Starts nothing heavy; bad input ends in one line."""

from __future__ import annotations

import os
import signal
import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Annotated

from cyclopts import App, Parameter

PACKAGES = ("blender_scenes", "gen", "recon", "learn")
"""What lies beside this module, in a clone as where it is installed."""

app = App(
    name="degloss",
    help="A few pictures of a shiny thing under known lights become its shape.",
    help_format="plaintext",
    version=lambda: version("degloss"),
    version_flags=["--version"],
    exit_on_error=False,
    print_error=False,
    suppress_keyboard_interrupt=False,
)
app.command("gen.cli:app", name="gen", help="The factory: render captures with their truth.")
app.command("recon.cli:app", name="recon", help="Measure: remove the gloss, repair, photometric stereo, height, mesh.")
app.command("learn.cli:app", name="learn", help="The networks that remove gloss: train, evaluate, apply, export.")


@app.command
def demo(
    *,
    output: Annotated[Path, Parameter(name=["--output", "-o"])] = Path("out/demo"),
    json: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
) -> None:
    """Render the paper's experiment with Blender, measure it, and write a report.

    A glossy cylinder under five lights and its gloss-free twin; gloss removed, defects repaired, normals, height, mesh, and the
    comparison against the non-glossy pictures and the true geometry.

    Parameters
    ----------
    output
        The folder to write; an earlier result there is replaced.
    json
        Print the metrics as one JSON object on stdout.
    """
    from recon.demo import run_demo

    run_demo(output, json)


@app.command
def doctor(*, json: Annotated[bool, Parameter(negative=(), show_default=False)] = False) -> None:
    """Say what is there and what is missing, each with its remedy.

    Parameters
    ----------
    json
        Print one JSON object on stdout.
    """
    from gen.doctor import examine

    examine(json)


def main() -> None:
    """The command's entry: bad input ends in one line and exit code 2, a signal in a sentence, with nothing half-written."""
    interrupted = False

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal interrupted
        interrupted = True
        if _swallowed(frame):  # once more, a moment later
            signal.setitimer(signal.ITIMER_REAL, 0.02)
            return
        raise KeyboardInterrupt

    signal.signal(signal.SIGALRM, stop)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # nohup's wish stands
            signal.signal(number, stop)
    for stream in (sys.stdout, sys.stderr):
        stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr] # a name may not fit the terminal's encoding
    if not os.environ.get("COLUMNS", "80").isdecimal() or int(os.environ.get("COLUMNS", "80")) < 20:
        del os.environ["COLUMNS"]
    if stranger := _stranger():
        sys.exit(_refuse(stranger))
    try:
        app(sys.argv[1:])
        sys.stdout.flush()
    except BaseException as error:
        if interrupted:  # whatever it came as: a module that is interrupted while it is imported fails in its own way
            how = str(error) if isinstance(error, KeyboardInterrupt) else ""  # a command may know better how to go on
            print(f"degloss: {how or 'stopped; nothing was left half-written, run the same command again'}", file=sys.stderr)
            sys.exit(130)
        sys.exit(_verdict(error))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)  # an alarm still to come would kill Python while it ends


def _stranger() -> str | None:
    """What is wrong where a package of ours is missing, or another project's of the same name comes first on Python's path."""
    for name in PACKAGES:
        spec = find_spec(name)
        if spec is None or spec.origin is None:
            return f"the package {name} is missing: install degloss again"
        folder = Path(spec.origin).resolve().parent
        if folder.parent != Path(__file__).resolve().parent:
            return (
                f"{folder}: a package of another project, called {name} like one of degloss, comes first on Python's path: "
                "rename it, or take its place out of PYTHONPATH and start elsewhere"
            )
    return None


def _swallowed(frame: FrameType | None) -> bool:
    """Whether an interrupt here might be lost, or printed and lost: while a module is imported, and in what LLVM calls back."""
    while frame is not None:
        name = frame.f_globals.get("__name__") or ""
        if name == "importlib._bootstrap" or name.startswith("llvmlite."):
            return True
        frame = frame.f_back
    return False


def _verdict(error: BaseException) -> int:
    """The exit code of an error that ends the command, after its line on stderr; errors of our own making are raised again."""
    from cyclopts import CycloptsError

    from gen.errors import InputError

    match error:
        case SystemExit():
            raise error
        case BrokenPipeError():
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        case InputError() | OSError() | UnicodeError():
            return _refuse(str(error))
        case ImportError():
            return _refuse(
                f"the package {error.name} is missing or broken ({error}): install degloss again, with its dependencies"
            )
        case CycloptsError():
            return _refuse(f"{error} Try --help.")
    raise error


def _refuse(message: str) -> int:
    print(f"degloss: {' '.join(message.split())}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
