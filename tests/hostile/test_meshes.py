"""Hostile meshes through `degloss recon inspect`: GLB, OBJ, STL and PLY that are cut, lie, point elsewhere or hold no surface."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.hostile.commands import Case, require_refusal
from tests.hostile.files import glb, glb_of, npz_of, obj, pickled, ply, ply_of, stl
from tests.hostile.readers import READERS

POINTS = b"v 0 0 0\nv 1 0 0\nv 0 1 0\n"
ASCII = (
    "format ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
    "element face {}\nproperty list uchar int vertex_indices"
)


def scene(count: int = 3, **changes: object) -> dict[str, object]:
    """The JSON of a GLB with one triangle of so many points."""
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [{"bufferView": 0, "componentType": 5126, "count": count, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}],
        "buffers": [{"byteLength": 36}],
        **changes,
    }


TRIANGLE = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
NAN = float("nan")

MESHES: dict[str, tuple[str, Callable[[], bytes], str]] = {
    # what it is: (the ending, the file's bytes, what the line says)
    "glb: nothing": ("glb", lambda: b"", "is empty"),
    "glb: its mark alone": ("glb", lambda: glb()[:12], "not a whole GLB"),
    "glb: cut in its points": ("glb", lambda: glb()[:-100], ""),
    "glb: no JSON": ("glb", lambda: glb_of(b"{"), "not a whole GLB"),
    "glb: nested 100,000 deep": ("glb", lambda: glb_of(b"[" * 100_000), "not a whole GLB"),
    "glb: four billion points": ("glb", lambda: glb_of(scene(2**32), TRIANGLE), "not a whole GLB"),
    "glb: minus one point": ("glb", lambda: glb_of(scene(-1), TRIANGLE), "not a whole GLB"),
    "glb: its points in another file": (
        "glb",
        lambda: glb_of(scene(buffers=[{"uri": "../secret.bin", "byteLength": 36}])),
        "in other files",
    ),
    "glb: its points at an address": (
        "glb",
        lambda: glb_of(scene(buffers=[{"uri": "https://example.org/x", "byteLength": 36}])),
        "in other files",
    ),
    "glb: a million nodes": ("glb", lambda: glb_of(scene(nodes=[{"mesh": 0}] * 200_000), TRIANGLE), "not a whole GLB"),
    "glb: a node inside itself": ("glb", lambda: glb_of(scene(nodes=[{"mesh": 0, "children": [0]}]), TRIANGLE), ""),
    "glb: no meshes": ("glb", lambda: glb_of(scene(meshes=[], nodes=[]), TRIANGLE), ""),
    "glb: scaled to nothing": ("glb", lambda: glb_of(scene(nodes=[{"mesh": 0, "scale": [0, 0, 0]}]), TRIANGLE), ""),
    "glb: placed at NaN": ("glb", lambda: glb_of(scene(nodes=[{"mesh": 0, "translation": [None, 0, 0]}]), TRIANGLE), ""),
    "glb: points that are NaN": ("glb", lambda: glb_of(scene(), struct.pack("<9f", NAN, 0, 0, 1, 0, 0, 0, 1, 0)), "not finite"),
    "glb: a Blender file": ("glb", lambda: b"BLENDER-v405" + b"\0" * 100, "not a whole GLB"),
    "obj: nothing": ("obj", lambda: b"", "is empty"),
    "obj: points without faces": ("obj", lambda: POINTS, ""),
    "obj: a point that is not there": ("obj", lambda: POINTS + b"f 1 2 9\n", ""),
    "obj: points that are NaN": ("obj", lambda: b"v nan 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
    "obj: points without end": ("obj", lambda: b"v inf 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "not finite"),
    "obj: points beyond all measure": ("obj", lambda: b"v 1e300 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", "too large"),
    "obj: points of one number": ("obj", lambda: b"v 1\nv 2\nv 3\nf 1 2 3\n", ""),
    "obj: a face without area": ("obj", lambda: b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", ""),
    "obj: all in one place": ("obj", lambda: b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", "in one place"),
    "obj: zero bytes": ("obj", lambda: obj() + b"\0", "not text"),
    "obj: a pickle": ("obj", pickled, ""),
    "obj: six million faces": ("obj", lambda: POINTS + b"f 1 2 3\n" * 5_000_001, "million faces"),
    "stl: nothing": ("stl", lambda: b"", "is empty"),
    "stl: cut": ("stl", lambda: stl()[:-10], "not a whole STL"),
    "stl: four billion faces": ("stl", lambda: stl()[:80] + b"\xff\xff\xff\xff" + stl()[84:], "not a whole STL"),
    "stl: no faces": ("stl", lambda: b"\0" * 84, ""),
    "stl: points that are NaN": ("stl", lambda: stl()[:84] + struct.pack("<12fH", *[NAN] * 12, 0) * 12, "not finite"),
    "stl: text that is cut": ("stl", lambda: stl("ascii")[:400], ""),
    "stl: text of NaN": (
        "stl",
        lambda: (
            b"solid x\nfacet normal 0 0 1\nouter loop\nvertex nan 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\nendsolid\n"
        ),
        "",
    ),
    "stl: an archive": ("stl", lambda: npz_of({"a": b"b" * 200}), "not a whole STL"),
    "ply: nothing": ("ply", lambda: b"", "is empty"),
    "ply: no header": ("ply", lambda: b"ply\n", "no header"),
    "ply: cut in its points": ("ply", lambda: ply()[:-30], ""),
    "ply: four billion points": ("ply", lambda: ply_of(ASCII.format(2**32, 1)), "not a whole PLY"),
    "ply: ten billion points, spelt oddly": ("ply", lambda: ply_of(ASCII.format("9_999_999_999", 1)), ""),
    "ply: four billion faces, spelt oddly": ("ply", lambda: ply_of(ASCII.format(3, "+4000000000"), b"0 0 0\n1 0 0\n0 1 0\n"), ""),
    "ply: minus one point": ("ply", lambda: ply_of(ASCII.format(-1, 1)), ""),
    "ply: a point that is not there": ("ply", lambda: ply_of(ASCII.format(3, 1), b"0 0 0\n1 0 0\n0 1 0\n3 0 1 9\n"), ""),
    "ply: points that are NaN": ("ply", lambda: ply_of(ASCII.format(3, 1), b"nan 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"), ""),
    "ply: points without faces": ("ply", lambda: ply_of(ASCII.format(3, 0), b"0 0 0\n1 0 0\n0 1 0\n"), ""),
    "ply: a form that does not exist": ("ply", lambda: ply_of(ASCII.format(3, 1).replace("ascii", "utf-16")), ""),
    "ply: in pixels": (
        "ply",
        lambda: ply("ascii").replace(b"format ascii 1.0\n", b"format ascii 1.0\ncomment unit px\n"),
        "in pixels",
    ),
    "a Blender file": ("blend", lambda: b"BLENDER-v405" + b"\0" * 100, "is not one of"),
    "a file without an ending": ("", stl, "is not one of"),
}


@pytest.mark.parametrize("what", MESHES)
def test_a_hostile_mesh_is_refused(what: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    ending, data, says = MESHES[what]
    name = f"part.{ending}" if ending else "part"

    def lay(folder: Path) -> None:
        (folder / "measured").mkdir()
        READERS["measurement"].lay(folder / "measured")
        (folder / name).write_bytes(data())
        (folder / "secret.bin").write_bytes(TRIANGLE)

    case = Case(lay, f"recon inspect HERE/measured HERE/{name} -o HERE/out --tolerance 0.1", name, says)
    require_refusal(case, tmp_path, capfd)
