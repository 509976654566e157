"""Bad captures: each is refused in one line that names the file, by `read_capture` and by the command, and nothing is written."""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gen.capture import read_capture
from gen.errors import InputError
from gen.exr import write_exr
from gen.images import write_png

ROOT = Path(__file__).resolve().parents[2]
LIGHTS = np.array([[0, 0, 1], [0.5, 0, 0.9], [-0.5, 0, 0.9], [0, 0.5, 0.9], [0, -0.5, 0.9]])
NAMES = [f"{k}.png" for k in range(1, 6)]


def rows(values: np.ndarray) -> str:
    return "".join(" ".join(str(v) for v in row) + "\n" for row in values)


def good(folder: Path, kind: str) -> Path:
    """A sound capture of five 8x6 pictures in the layout `kind`: what a user names."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    where = folder / "thing" if kind == "psm" else folder
    for k, name in enumerate(NAMES):
        picture = rng.integers(1, 60000, (6, 8, 3)).astype(np.uint16)
        if kind == "exr":
            write_exr(folder / f"{k + 1}.exr", {letter: picture[..., i] / 65535 for i, letter in enumerate("RGB")})
        else:
            write_png(where / name, picture)
    write_png((where / "thing.mask.png") if kind == "psm" else folder / "mask.png", np.full((6, 8), 255, np.uint8))
    if kind == "diligent":
        (folder / "filenames.txt").write_text("\n".join(NAMES))
        (folder / "light_directions.txt").write_text(rows(LIGHTS))
        (folder / "light_intensities.txt").write_text(rows(np.ones((5, 3))))
    elif kind == "rti":
        (folder / "dirs.lp").write_text(
            "5\n" + "".join(f"{n} {row}" for n, row in zip(NAMES, rows(LIGHTS).splitlines(True), strict=True))
        )
    elif kind == "psm":
        (folder / "thing.txt").write_text("5\n" + "\n".join(f"psmImages/thing/{n}" for n in [*NAMES, "thing.mask.png"]))
        (folder / "lights.txt").write_text("5\n" + rows(LIGHTS))
        return where
    else:
        (folder / "lights.txt").write_text(rows(LIGHTS))
    return folder


def replaced(file: str, old: str, new: str) -> Callable[[Path], None]:
    def harm(folder: Path) -> None:
        text = (folder / file).read_text()
        assert old in text
        (folder / file).write_text(text.replace(old, new, 1))

    return harm


def text(file: str, content: str | bytes) -> Callable[[Path], None]:
    return lambda folder: (folder / file).write_bytes(content.encode() if isinstance(content, str) else content) and None


def gone(*files: str) -> Callable[[Path], None]:
    def harm(folder: Path) -> None:
        for file in files:
            (folder / file).unlink()

    return harm


def cut(file: str, share: float = 0.6) -> Callable[[Path], None]:
    return lambda folder: (folder / file).write_bytes((data := (folder / file).read_bytes())[: int(len(data) * share)]) and None


def picture(file: str, array: np.ndarray) -> Callable[[Path], None]:
    return lambda folder: write_png(folder / file, array)


def exr(file: str, value: float, size: tuple[int, int] = (6, 8)) -> Callable[[Path], None]:
    return lambda folder: write_exr(folder / file, {letter: np.full(size, value) for letter in "RGB"})


def all_holes(folder: Path) -> None:
    for k in range(1, 6):
        exr(f"{k}.exr", np.nan)(folder)


def outward_link(folder: Path) -> None:
    secret = folder.parent / "secret.png"
    (folder / "2.png").rename(secret)
    (folder / "2.png").symlink_to(secret)


def cut_of_another_kind(kind: str) -> Callable[[Path], None]:
    def harm(folder: Path) -> None:
        import cv2

        done, data = cv2.imencode(kind, np.random.default_rng(1).integers(0, 255, (60, 80, 3)).astype(np.uint8))
        assert done
        for name in NAMES:
            (folder / name).unlink()
            (folder / name).with_suffix(kind).write_bytes(data.tobytes())
        gone("mask.png")(folder)
        cut(f"3{kind}")(folder)

    return harm


def huge_png(folder: Path) -> None:
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", 100_000, 100_000, 16, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(b"\0" * 99)),
        (b"IEND", b""),
    )
    body = b"".join(struct.pack(">I", len(b)) + t + b + struct.pack(">I", zlib.crc32(t + b)) for t, b in chunks)
    (folder / "1.png").write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def pickled(folder: Path) -> None:
    np.savez(folder / "normal_gt.npz", normal=np.array([print], dtype=object))


BAD: dict[str, tuple[str, Callable[[Path], object], str, str]] = {
    # what is wrong: (layout, how it is done, the file that the line must name, what it must say)
    "plain: no light file": ("plain", gone("lights.txt"), "lights.txt", "no such file"),
    "plain: a light too few": ("plain", text("lights.txt", rows(LIGHTS[:4])), "lights.txt", "4 light directions for 5 pictures"),
    "plain: a picture too few": ("plain", gone("3.png"), "lights.txt", "5 light directions for 4 pictures"),
    "plain: a light of no length": (
        "plain",
        text("lights.txt", rows(LIGHTS * [[1], [0], [1], [1], [1]])),
        "lights.txt",
        "direction 2 has no length",
    ),
    "plain: a light of hardly any length": (
        "plain",
        replaced("lights.txt", "0.5 0.0 0.9", "1e-9 0 0"),
        "lights.txt",
        "direction 2 has no length",
    ),
    "plain: NaN in the lights": (
        "plain",
        replaced("lights.txt", "0.5", "nan"),
        "lights.txt",
        "line 2 holds a value that is not finite",
    ),
    "plain: infinity in the lights": (
        "plain",
        replaced("lights.txt", "0.5", "inf"),
        "lights.txt",
        "line 2 holds a value that is not finite",
    ),
    "plain: a row too short": ("plain", replaced("lights.txt", "0.5 0.0 0.9", "0.5 0.9"), "lights.txt", "line 2 has 2 values"),
    "plain: rows of two": ("plain", text("lights.txt", rows(LIGHTS[:, :2])), "lights.txt", "rows of x y z"),
    "plain: words for lights": ("plain", text("lights.txt", "left\nright\n"), "lights.txt", "line 1"),
    "plain: an empty light file": ("plain", text("lights.txt", ""), "lights.txt", "is empty"),
    "plain: only comments": ("plain", text("lights.txt", "# soon\n"), "lights.txt", "holds no"),
    "plain: lights not UTF-8": ("plain", text("lights.txt", b"\xff\xfe\x00\x31"), "lights.txt", "not UTF-8"),
    "plain: lights binary": ("plain", text("lights.txt", b"1 2 3\0\0\0"), "lights.txt", "not a text file"),
    "plain: a count that is wrong": ("plain", text("lights.txt", "6\n" + rows(LIGHTS)), "lights.txt", "says 6, but 5 rows"),
    "plain: a name twice": (
        "plain",
        text("lights.txt", "1.png 0 0 1\n1.png 0 1 1\n2.png 1 0 1\n"),
        "lights.txt",
        "names 1.png twice",
    ),
    "plain: a name twice, spelt otherwise": (
        "plain",
        text("lights.txt", "1.png 0 0 1\n./1.png 0 1 1\n2.png 1 0 1\n"),
        "lights.txt",
        "twice",
    ),
    "plain: a named picture is not there": ("plain", text("lights.txt", "1.png 0 0 1\n9.png 0 1 1\n"), "9.png", "no such file"),
    "plain: a name leads up": (
        "plain",
        text("lights.txt", "../1.png 0 0 1\n2.png 0 1 1\n"),
        "lights.txt",
        "leads out of the folder",
    ),
    "plain: an absolute name": (
        "plain",
        text("lights.txt", "/etc/hosts 0 0 1\n2.png 0 1 1\n"),
        "lights.txt",
        "leads out of the folder",
    ),
    "plain: a link that leads out": ("plain", outward_link, "lights.txt", "leads out of the folder"),
    "plain: a negative intensity": (
        "plain",
        text("intensities.txt", "1\n1\n-1\n1\n1\n"),
        "intensities.txt",
        "intensity 3 is not positive",
    ),
    "plain: a zero intensity": (
        "plain",
        text("intensities.txt", rows(np.eye(5)[:, :3] + [0, 1, 1])),
        "intensities.txt",
        "intensity 2 is not positive",
    ),
    "plain: intensities too few": (
        "plain",
        text("intensities.txt", "1\n1\n"),
        "intensities.txt",
        "2 light intensities for 5 pictures",
    ),
    "plain: intensities of two": ("plain", text("intensities.txt", "1 1\n" * 5), "intensities.txt", "rows of 2 numbers"),
    "plain: intensities NaN": ("plain", text("intensities.txt", "1\nnan\n1\n1\n1\n"), "intensities.txt", "not finite"),
    "plain: a picture cut short": ("plain", cut("2.png"), "2.png", "damaged or truncated"),
    "plain: the first picture cut short": ("plain", cut("1.png"), "1.png", "damaged or truncated"),
    "plain: an empty picture": ("plain", text("4.png", ""), "4.png", "is empty"),
    "plain: text named .png": ("plain", text("4.png", "hello, this is no picture\n"), "4.png", "is not a picture"),
    "plain: a picture of another size": (
        "plain",
        picture("5.png", np.ones((6, 7, 3), np.uint16)),
        "5.png",
        "all pictures must have one size",
    ),
    "plain: one 8-bit picture": ("plain", picture("5.png", np.ones((6, 8, 3), np.uint8)), "5.png", "srgb or linear"),
    "plain: a mask of another size": (
        "plain",
        picture("mask.png", np.full((8, 6), 255, np.uint8)),
        "mask.png",
        "the mask is 6x8 pixels",
    ),
    "plain: an empty mask": ("plain", picture("mask.png", np.zeros((6, 8), np.uint8)), "mask.png", "the mask is empty"),
    "plain: a mask cut short": ("plain", cut("mask.png"), "mask.png", "damaged or truncated"),
    "plain: a picture that claims to be huge": ("plain", huge_png, "1.png", "megapixels"),
    "plain: a JPEG cut short": ("plain", cut_of_another_kind(".jpg"), "3.jpg", "damaged or truncated"),
    "plain: a TIFF cut short": ("plain", cut_of_another_kind(".tiff"), "3.tiff", "damaged or truncated"),
    "plain: truth made of Python objects": ("plain", pickled, "normal_gt.npz", "Python objects"),
    "plain: no pictures": ("plain", gone(*NAMES, "mask.png"), "capture", "not a capture that is known"),
    "plain: only a mask": ("plain", gone(*NAMES), "capture", "not a capture that is known"),
    "exr: cut short": ("exr", cut("2.exr"), "2.exr", "damaged or truncated"),
    "exr: not one value": ("exr", all_holes, "capture", "not one"),
    "exr: another size": ("exr", exr("4.exr", 0.5, (6, 9)), "4.exr", "one size"),
    "diligent: no light directions": ("diligent", gone("light_directions.txt"), "light_directions.txt", "no such file"),
    "diligent: no light intensities": ("diligent", gone("light_intensities.txt"), "light_intensities.txt", "no such file"),
    "diligent: no mask": ("diligent", gone("mask.png"), "mask.png", "no such file"),
    "diligent: a picture is not there": ("diligent", gone("3.png"), "3.png", "no such file"),
    "diligent: a name too few": (
        "diligent",
        replaced("filenames.txt", "1.png\n", ""),
        "light_directions.txt",
        "5 light directions for 4 pictures",
    ),
    "diligent: a name leads up": ("diligent", replaced("filenames.txt", "1.png", "../1.png"), "filenames.txt", "leads out"),
    "diligent: an absolute name": ("diligent", replaced("filenames.txt", "1.png", "/etc/passwd"), "filenames.txt", "leads out"),
    "diligent: a name twice": ("diligent", replaced("filenames.txt", "1.png", "2.png"), "filenames.txt", "names 2.png twice"),
    "diligent: names not UTF-8": ("diligent", text("filenames.txt", b"\xe9.png\n"), "filenames.txt", "not UTF-8"),
    "diligent: an empty list": ("diligent", text("filenames.txt", ""), "filenames.txt", "is empty"),
    "diligent: a list of blanks": ("diligent", text("filenames.txt", "\n \n"), "filenames.txt", "names no pictures"),
    "rti: a light too few": ("rti", replaced("dirs.lp", "3.png -0.5 0.0 0.9\n", ""), "dirs.lp", "says 5, but 4 rows follow"),
    "rti: a light of no length": ("rti", replaced("dirs.lp", "-0.5 0.0 0.9", "0 0 0"), "dirs.lp", "direction 3 has no length"),
    "rti: NaN": ("rti", replaced("dirs.lp", "-0.5", "nan"), "dirs.lp", "line 4 holds a value that is not finite"),
    "rti: a row too short": (
        "rti",
        replaced("dirs.lp", "-0.5 0.0 0.9", "0 0.9"),
        "dirs.lp",
        "line 4 is not a file name and three numbers",
    ),
    "rti: a name leads up": ("rti", replaced("dirs.lp", "1.png", "../../1.png"), "dirs.lp", "leads out"),
    "rti: an absolute name": ("rti", replaced("dirs.lp", "1.png", "/home/me/1.png"), "dirs.lp", "leads out"),
    "rti: a name of a Windows drive": ("rti", replaced("dirs.lp", "1.png", "C:\\rti\\1.png"), "dirs.lp", "leads out"),
    "rti: a name twice": ("rti", replaced("dirs.lp", "1.png", "2.png"), "dirs.lp", "names 2.png twice"),
    "rti: an empty list": ("rti", text("dirs.lp", ""), "dirs.lp", "is empty"),
    "rti: only a count": ("rti", text("dirs.lp", "5\n"), "dirs.lp", "line 1"),
    "psm: a name leads up": (
        "psm",
        replaced("../thing.txt", "psmImages/thing/1.png", "psmImages/../../1.png"),
        "thing.txt",
        "leads out",
    ),
    "psm: a count that differs": ("psm", replaced("../thing.txt", "5", "7"), "thing.txt", "says 7 pictures"),
    "psm: a light too few": (
        "psm",
        text("../lights.txt", "4\n" + rows(LIGHTS[:4])),
        "lights.txt",
        "4 light directions for 5 pictures",
    ),
    "psm: a picture is not there": ("psm", gone("2.png"), "2.png", "no such file"),
    "psm: an empty mask": ("psm", picture("thing.mask.png", np.zeros((6, 8), np.uint8)), "thing.mask.png", "empty"),
}


@pytest.mark.parametrize("kind", ["plain", "exr", "diligent", "rti", "psm"])
def test_the_captures_are_sound_before_they_are_harmed(tmp_path: Path, kind: str) -> None:
    capture = read_capture(good(tmp_path / "capture", kind))
    assert (capture.count, capture.size) == (5, (6, 8))
    assert capture.valid.all()


@pytest.mark.parametrize("case", list(BAD))
def test_a_bad_capture_is_refused_in_one_line_that_names_the_file(
    tmp_path: Path, case: str, capfd: pytest.CaptureFixture[str]
) -> None:
    kind, harm, file, why = BAD[case]
    path = good(tmp_path / "capture", kind)
    harm(path)
    with pytest.raises(InputError) as error:
        read_capture(path)
    line = str(error.value)
    assert "\n" not in line
    named = line.split(": ")[0]
    assert named.endswith(file), line
    assert why in line
    assert capfd.readouterr() == ("", ""), "no library prints lines of its own"


def test_holes_in_some_pictures_are_marked_and_the_rest_is_read(tmp_path: Path) -> None:
    path = good(tmp_path / "capture", "exr")
    exr("3.exr", np.nan)(path)
    capture = read_capture(path)
    assert not capture.valid[2].any()
    assert capture.valid[[0, 1, 3, 4]].all()


BY_COMMAND = (
    "plain: no light file",
    "plain: a light too few",
    "plain: a light of no length",
    "plain: NaN in the lights",
    "plain: a link that leads out",
    "plain: a picture cut short",
    "plain: a JPEG cut short",
    "plain: a picture of another size",
    "plain: an empty mask",
    "exr: cut short",
    "exr: not one value",
    "diligent: a name leads up",
)


def degloss(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "degloss", *map(str, arguments)],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=120,
    )


def refused(done: subprocess.CompletedProcess[str], out: Path) -> str:
    """The one line on stderr of a command that ended with 2 and left nothing behind. How the pictures were read is no complaint."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert len(lines) == 1, done.stderr
    assert not out.exists()
    assert not list(out.parent.glob(".*")), "nothing half-written"
    return lines[0]


@pytest.mark.parametrize("case", BY_COMMAND)
def test_a_bad_capture_ends_the_command_with_one_line(tmp_path: Path, case: str) -> None:
    kind, harm, file, why = BAD[case]
    path = good(tmp_path / "capture", kind)
    harm(path)
    line = refused(degloss("recon", "run", path, "-o", tmp_path / "out"), tmp_path / "out")
    assert file in line
    assert why in line


def test_coplanar_lights_end_the_command_with_one_line(tmp_path: Path) -> None:
    path = good(tmp_path / "capture", "plain")
    t = np.radians([-40, -20, 0, 20, 40])
    (path / "lights.txt").write_text(rows(np.stack([np.sin(t), 0 * t, np.cos(t)], 1)))
    line = refused(degloss("recon", "run", path, "-o", tmp_path / "out"), tmp_path / "out")
    assert "lie in one plane" in line


def test_an_output_that_cannot_be_written_ends_the_command_with_one_line(tmp_path: Path) -> None:
    path = good(tmp_path / "capture", "plain")
    (tmp_path / "file").write_text("x")
    done = degloss("recon", "run", path, "-o", tmp_path / "file" / "out")
    assert done.returncode == 2, done.stderr
    assert "cannot be written" in done.stderr.splitlines()[-1]
    assert (tmp_path / "file").read_text() == "x"
