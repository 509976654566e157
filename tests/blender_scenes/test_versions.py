"""Blenders that will not do are told so in one line, before anything that they lack is used."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from blender_scenes.errors import MissingBlender
from blender_scenes.versions import check_version

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("version", [(2, 79, 0), (3, 4, 1), (3, 6, 23), (4, 2, 23), (4, 4, 3)])
def test_old_versions_are_refused_by_name(version: tuple[int, ...]) -> None:
    with pytest.raises(MissingBlender, match=r"^Blender {}\.{}\.{} is too old: 4\.5 or newer is needed".format(*version)):
        check_version(version)


@pytest.mark.parametrize("version", [(4, 5, 0), (4, 5, 15), (5, 0, 1), (5, 2, 2), (6, 0, 0), (10, 1, 0)])
def test_newer_versions_may_try(version: tuple[int, ...]) -> None:
    check_version(version)


HOST = """
import runpy, sys, types
sys.modules['bpy'] = types.SimpleNamespace(app=types.SimpleNamespace(version={version}))
sys.modules['numpy'] = None
print('what Blender prints on its way')
script, sys.argv = sys.argv[1], ['blender', '-b', '--python', 'x.py', '--', *sys.argv[2:]]
runpy.run_path(script, run_name='__main__')
"""


@pytest.mark.parametrize(
    ("version", "message"),
    [
        ((3, 4, 1), "Blender 3.4.1 is too old: 4.5 or newer is needed (tested: 4.5 LTS, 5.0 and 5.2 LTS)"),
        (
            (5, 2, 2),
            f"the Python of this Blender has no numpy: install it for Python {sys.version_info[0]}.{sys.version_info[1]}"
            " (on Debian or Ubuntu: apt-get install -y python3-numpy)",
        ),
    ],
)
@pytest.mark.parametrize("as_worker", [False, True])
def test_the_entry_refuses_before_it_needs_anything(version, message: str, as_worker: bool, tmp_path: Path) -> None:
    """A distribution's Blender, too old or without numpy: one line, the last, and exit code 2, as a worker and for one job."""
    (tmp_path / "job.json").write_text(json.dumps({}))
    arguments = ["--worker"] if as_worker else [str(tmp_path / "job.json"), "-o", str(tmp_path / "out.npz")]
    script = str(ROOT / "blender_scenes" / "__main__.py")
    done = subprocess.run(
        [sys.executable, "-c", HOST.format(version=version), script, *arguments],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=60,
    )
    assert (done.returncode, done.stdout.splitlines()) == (2, ["what Blender prints on its way", message])
    assert not (tmp_path / "out.npz").exists()
