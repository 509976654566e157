"""The studio's plain entry.

python -m blender_scenes JOB.json -o OUT.npz
python -m blender_scenes --worker [--in FD --out FD] [--threads N] [--route auto|memory|exr] [--device auto|cpu|gpu]
blender -b --factory-startup --python blender_scenes/__main__.py -- (the same arguments)
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import traceback
from pathlib import Path


def main(arguments: list[str]) -> int:
    """Run the command line; the exit code is 0, or 2 after one line on standard error."""
    parser = argparse.ArgumentParser(prog="blender_scenes", description="Render one job of a shape under K lights into layers.")
    parser.add_argument("job", nargs="?", type=Path, help="the job, a JSON file")
    parser.add_argument("-o", dest="output", type=Path, help="the layers, an .npz file (default: the job's own 'out')")
    parser.add_argument("--worker", action="store_true", help="serve JSON jobs, one a line")
    parser.add_argument("--in", dest="source", type=int, default=0, metavar="FD", help="descriptor of the worker's jobs")
    parser.add_argument("--out", dest="sink", type=int, default=1, metavar="FD", help="descriptor of the worker's replies")
    parser.add_argument("--threads", type=int, default=0, help="Cycles' threads (default: all cores)")
    parser.add_argument("--route", choices=("auto", "memory", "exr"), default="auto", help="how the pixels leave Blender")
    parser.add_argument("--device", choices=("auto", "cpu", "gpu"), default="cpu", help="what Cycles computes on (default: cpu)")
    options = parser.parse_args(arguments)
    if options.worker == (options.job is not None):
        parser.error("give either a job or --worker")
    if not 0 <= options.threads <= 1024:
        parser.error("--threads must be from 0 to 1024")

    from blender_scenes.errors import JobError
    from blender_scenes.versions import check_host

    try:
        check_host()
        if options.worker:
            from blender_scenes.worker import serve

            serve(options.source, options.sink, options.threads, options.route, options.device)
        else:
            _render(options.job, options.output, options.threads, options.route, options.device)
    except JobError as error:
        sys.stdout.flush()  # what Blender has printed comes first: who reads both takes the last line for the reason
        print(error, file=sys.stderr)
        return 2
    return 0


def _render(path: Path, output: Path | None, threads: int, route: str, device: str) -> None:
    from blender_scenes.errors import JobError
    from blender_scenes.shot import shoot
    from blender_scenes.studio import empty_scene
    from blender_scenes.worker import write

    try:
        job = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise JobError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        raise JobError(f"{path}: is not JSON ({error})") from None
    place = output or (Path(job["out"]) if isinstance(job, dict) and isinstance(job.get("out"), str) else None)
    if place is None:
        raise JobError(f"{path}: names no 'out'; say -o OUT.npz")
    _silence()
    arrays, _ = shoot(empty_scene(threads, device), job, route)
    write(place, arrays)


def _silence() -> None:
    """Send standard output to nowhere: Blender prints some thirty lines a render on it."""
    sys.stdout.flush()
    with open(os.devnull, "w") as nowhere:
        os.dup2(nowhere.fileno(), 1)


if __name__ == "__main__":
    # Started as a script (blender --python), only this folder is on the path, or none: the package lies in the folder above.
    here = Path(__file__).resolve().parent
    sys.path[:] = [str(here.parent), *(entry for entry in sys.path if not entry or Path(entry).resolve() != here)]
    code: object = 1
    try:
        code = main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
    except SystemExit as end:
        code = end.code
    except BaseException:  # Blender would end with 0 whatever its script did
        sys.stdout.flush()
        traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    # At once: what Blender does on its way out may print, or crash, after all is done.
    os._exit(code if isinstance(code, int) else 0)
