"""The worker: one JSON job a line in, one JSON reply a line out, on descriptors of its own.

First line out: {"ready": true, "blender": version, "device": "cpu", "pid": pid}. Then for each job, in order,
{"id": id, "ok": true, "seconds": s, "route": "memory" | "exr"} with the arrays in the job's "out" (.npz, uncompressed), or
{"id": id, "ok": false, "kind": "input" | "failure", "error": one line}. The worker ends when its input closes or its parent dies.
"""

from __future__ import annotations

import json
import os
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from blender_scenes.errors import JobError


def serve(source: int, sink: int, threads: int = 0, route: str = "auto", device: str = "cpu") -> None:
    """Serve jobs from the file descriptor `source` to `sink` until the input closes.

    threads: of Cycles, 0 for all cores. route: see `blender_scenes.passes.render`. device: see `blender_scenes.studio.empty_scene`. Raises
    MissingBlender where there is no bpy, JobError where there is no such device.
    """
    for descriptor in (source, sink):
        try:
            os.fstat(descriptor)
        except OSError:
            raise JobError(
                f"worker: descriptor {descriptor} is not open; pass --in and --out descriptors that the worker inherits"
            ) from None
    _end_with(os.getppid())
    if sink == 1:
        # Blender prints to standard output on its own: keep that for the protocol, and send the prints to standard error.
        sink = os.dup(1)
        os.dup2(2, 1)
    from blender_scenes.shot import shoot
    from blender_scenes.studio import blender, empty_scene

    version = blender().app.version_string.split()[0]
    scene = empty_scene(threads, device)
    _say(sink, {"ready": True, "blender": version, "device": scene.cycles.device.lower(), "pid": os.getpid()})
    for line in _lines(source):
        began = time.perf_counter()
        name: Any = None
        try:
            job = _parse(line)
            name = job.get("id")
            out = job.get("out")
            if not isinstance(out, str) or not Path(out).parent.is_dir():
                raise JobError(f"job: out must be a path in a folder that is there, got {out!r}")
            arrays, taken = shoot(scene, job, route)
            write(Path(out), arrays)
            reply = {"id": name, "ok": True, "seconds": round(time.perf_counter() - began, 4), "route": taken}
        except JobError as error:
            reply = {"id": name, "ok": False, "kind": "input", "error": str(error)}
        except Exception as error:  # whatever one job did, the next one is served
            text = " ".join(f"{type(error).__name__}: {error}".split())
            reply = {"id": name, "ok": False, "kind": "failure", "error": text[:500]}
        _say(sink, reply)


def write(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as an uncompressed .npz under a temporary name, then rename it. Raises JobError where that is not possible."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        with temporary.open("wb") as stream:
            np.savez(stream, **arrays)
        os.replace(temporary, path)
    except OSError as error:
        temporary.unlink(missing_ok=True)
        raise JobError(f"job: out {path} cannot be written ({error.strerror or error})") from error


def _parse(line: bytes) -> dict[str, Any]:
    try:
        job = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise JobError(f"job: the line is not JSON ({error})") from None
    if not isinstance(job, dict):
        raise JobError("job: the line is not a JSON object")
    return job


def _lines(source: int) -> Iterator[bytes]:
    with os.fdopen(source, "rb", closefd=False) as stream:
        for line in stream:
            if line.strip():
                yield line


def _say(sink: int, reply: Mapping[str, Any]) -> None:
    data = (json.dumps(reply) + "\n").encode()
    try:
        while data:
            data = data[os.write(sink, data) :]
    except BrokenPipeError:
        os._exit(0)


def _end_with(parent: int) -> None:
    """End this process soon after its parent has. Closing the input does that too, but not in the midst of a long render."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(0.5)
        os._exit(0)

    threading.Thread(target=watch, daemon=True).start()
