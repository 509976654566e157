"""The front door: one command, `degloss`, which mounts gen and recon. Starts nothing heavy; bad input ends in one line."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

app = App(
    name="degloss",
    help="A few pictures of a shiny thing under known lights become its shape.",
    help_format="plaintext",
    version_flags=["--version"],
)
app.command("gen.cli:app", name="gen", help="The factory: render captures with their truth.")
app.command("recon.cli:app", name="recon", help="Measure: remove the gloss, repair, photometric stereo, height, mesh.")


@app.command
def demo(*, output: Annotated[Path, Parameter(name=["--output", "-o"])] = Path("out/demo"), json: bool = False) -> None:
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
def doctor(*, json: bool = False) -> None:
    """Say what is there and what is missing, each with its remedy.

    Parameters
    ----------
    json
        Print one JSON object on stdout.
    """
    from gen.doctor import examine

    examine(json)


def main() -> None:
    """The command's entry: bad input gives one line on stderr and exit code 2, Ctrl-C a sentence and 130."""
    from gen.errors import InputError

    try:
        app(exit_on_error=False, print_error=False)
    except InputError as error:
        sys.exit(_refuse(str(error)))
    except KeyboardInterrupt:
        print("degloss: stopped; nothing was left half-written, run the same command again", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        sys.exit(1)
    except Exception as error:
        from cyclopts import CycloptsError

        if not isinstance(error, CycloptsError):
            raise
        sys.exit(_refuse(str(error)))


def _refuse(message: str) -> int:
    print(f"degloss: {' '.join(message.split())}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    main()
