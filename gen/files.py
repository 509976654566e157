"""Writing so that nothing is ever left half-written, and reading so that nothing is trusted: paths, sizes, JSON."""

from __future__ import annotations

import ctypes
import hashlib
import io
import json
import os
import re
import shutil
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO, Any, TextIO

import numpy as np

from gen.errors import InputError

MAX_PIXELS = 200_000_000
"""The largest picture that any reader opens (H * W)."""


def memory() -> int:
    """Bytes of memory of this machine."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


@contextmanager
def writing(path: Path) -> Iterator[Path]:
    """A temporary name beside `path`, renamed to it when the block ends well and removed when it does not.

    Raises InputError where the folder cannot be written, or `path` is a folder itself.
    """
    if os.path.isdir(path):  # unlike Path.is_dir, which raises where a folder above may not be entered
        raise InputError(f"{path}: is a folder; give the name of a file with -o")
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error}); choose another place") from error
    finally:
        with suppress(OSError):  # what could not be written, for one, has no name to remove
            temporary.unlink()


@contextmanager
def writing_folder(path: Path, kind: str) -> Iterator[Path]:
    """A temporary folder beside `path` that takes its place when the block ends well; an earlier result there is replaced whole.

    kind: what the folder holds ("capture", "measurement", "demo"). Only an empty folder, or one that this program marked as a result of
    the same kind, is replaced; anything else is refused. Raises InputError where the place cannot be written or holds something else.
    """
    path = Path(os.path.abspath(path))
    if os.path.lexists(path) and not replaceable(path, kind):  # unlike Path.exists, which raises for a name too long to be one
        raise InputError(
            f"{path}: is there already and is not an earlier {kind} of ours, or holds other files too; choose another place"
        )
    temporary = old = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        _sweep(path)
        temporary = _beside(path, ".tmp")
        yield temporary
        names = sorted(p.relative_to(temporary).as_posix() for p in temporary.rglob("*") if not p.is_dir())
        (temporary / MARK).write_text(json.dumps({"degloss": kind, "files": names}) + "\n", encoding="utf-8")
        if path.exists():
            old = _beside(path, ".old")
            os.replace(path, old / path.name)
        os.replace(temporary, path)
    except OSError as error:
        reason = error.strerror or error
        if error.filename is not None and not _belongs(str(error.filename), path):
            raise InputError(f"{error.filename}: cannot be read or written ({reason})") from error
        raise InputError(f"{path}: cannot be written ({reason}); choose another place") from error
    finally:
        if old is not None and (old / path.name).exists() and not path.exists():
            os.replace(old / path.name, path)  # the new one did not come: the earlier result stays
        for left in (temporary, old):
            if left is not None and left.exists():
                shutil.rmtree(left, ignore_errors=True)


MARK = ".degloss"
"""The file that marks a folder as a result of ours: JSON with its kind and its files, so that a later run may replace it."""


def replaceable(path: Path, kind: str) -> bool:
    """Whether `path` is an empty folder, or an earlier result of this program of that kind that holds no file but its own."""
    if not path.is_dir() or path.is_symlink():
        return False
    found = {p.relative_to(path).as_posix() for p in path.rglob("*") if not p.is_dir()}
    if not found and not any(path.iterdir()):
        return True
    try:
        mark = json.loads((path / MARK).read_text(encoding="utf-8"))
        return bool(mark["degloss"] == kind and found <= {MARK, *mark["files"]})
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _beside(path: Path, ending: str) -> Path:
    """A new hidden folder beside `path` that names the process it belongs to."""
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.{os.getpid()}.", suffix=ending, dir=path.parent))
    folder.chmod(0o777 & ~_umask())
    return folder


def _sweep(path: Path) -> None:
    """Remove what a process that was killed left beside `path`."""
    pattern = re.compile(re.escape(f".{path.name}.") + r"(\d+)\.\w+\.tmp")
    for left in path.parent.iterdir():
        match = pattern.fullmatch(left.name)
        if match and left.is_dir() and not left.is_symlink() and not _alive(int(match[1])):
            shutil.rmtree(left, ignore_errors=True)


def _belongs(name: str, path: Path) -> bool:
    """Whether a file that failed is the output `path`, in it, above it, or its temporary form."""
    place = Path(os.path.abspath(name))
    return place == path or place in path.parents or any(p.name.startswith(f".{path.name}.") for p in (place, *place.parents))


def _alive(process: int) -> bool:
    """Whether a process of that number may be there: only a clear no counts as one."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # somebody else's, or no number of a process at all
        return True
    return True


def real(path: Path) -> Path:
    """`path`, absolute, without links and dots. A circle of links stays as it is; `Path.resolve` would raise RuntimeError."""
    return Path(os.path.realpath(path))


def keep_apart(source: Path, output: Path) -> None:
    """InputError where an output folder is, or holds, what is read: nothing may overwrite its own input."""
    place, read = real(output), real(source)
    folder = read if read.is_dir() else read.parent
    if place == folder or place in folder.parents:
        raise InputError(f"{output}: is or holds the capture {source}; choose another place")


def keep_outside(source: Path, output: Path) -> None:
    """InputError where an output lies in the folder that is read: what is read would grow by what is made of it."""
    if real(output).is_relative_to(real(source)):
        raise InputError(f"{output}: lies in {source} itself; choose another place")


def inside(folder: Path, name: str) -> Path:
    """The file `name` of `folder`; InputError where the name leads out of it (absolute, "..", or by a symbolic link)."""
    parts = PurePosixPath(name.replace("\\", "/"))
    if not name or "\0" in name or parts.is_absolute() or PureWindowsPath(name).drive or ".." in parts.parts:
        raise InputError(f"{folder}: the file name {name!r} leads out of the folder")
    path = folder / parts
    try:
        inside = real(path).is_relative_to(real(folder))
    except (OSError, UnicodeError) as error:
        raise InputError(f"{folder}: the file name {name!r} cannot be used here ({error})") from error
    if not inside:
        raise InputError(f"{folder}: the file name {name!r} leads out of the folder")
    return path


def must_exist(path: Path, what: str) -> Path:
    """`path`, which is a non-empty file; InputError otherwise. what: its role, for the message.

    Folders, pipes and devices are no files: reading a pipe would wait for ever, and a device has no end.
    """
    try:
        if not path.is_file():
            if not path.exists():
                raise InputError(f"{path}: there is no such file ({what})")
            kind = "a folder" if path.is_dir() else "a pipe or a device"
            raise InputError(f"{path}: is {kind}, not a file ({what})")
        size = path.stat().st_size
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}; {what})") from error
    if size == 0:
        raise InputError(f"{path}: is empty ({what})")
    return path


def sha256_of(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal. Raises OSError where it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_lines(path: Path, what: str, limit: int = 10_000_000) -> list[tuple[int, str]]:
    """The lines of a small UTF-8 text file that are not blank, stripped, each with its number from 1.

    limit: the largest size in bytes. Raises InputError where the file is missing, empty, too large or not text.
    """
    must_exist(path, what)
    if path.stat().st_size > limit:
        raise InputError(f"{path}: is too large to be a table of {what}")
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is not UTF-8 text ({what})") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}; {what})") from error
    if "\0" in text:
        raise InputError(f"{path}: is not a text file ({what})")
    return [(i, line.strip()) for i, line in enumerate(text.splitlines(), 1) if line.strip()]


def printable(text: str) -> str:
    """Text that any file and any terminal takes. The name of a file need not be text: bytes that are none are spelt out, as \\udce9."""
    return text if text.isascii() else text.encode("utf-8", "backslashreplace").decode("utf-8")


def is_count(word: str) -> bool:
    """Whether a word is the number of something: decimal digits, not so many that Python refuses to read them."""
    return word.isdecimal() and len(word) < 20


def read_numbers(
    path: Path, what: str, columns: int | tuple[int, ...] | None, limit: int = 10_000_000
) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Rows of numbers from a text file, blanks, commas or semicolons between them, all rows of one length.

    columns: the length of a row, several that are allowed, or None for any. Text after '#' is ignored. A first row that holds
    only the count is checked against the rows that follow and left out. Returns (N, columns) float64. Raises InputError, naming
    the line, for anything else.
    """
    allowed = (columns,) if isinstance(columns, int) else columns
    lines = [(i, line.split("#")[0].replace(",", " ").replace(";", " ").split()) for i, line in read_lines(path, what, limit)]
    lines = [(i, words) for i, words in lines if words]
    if not lines:
        raise InputError(f"{path}: holds no numbers ({what})")
    if len(lines) > 1 and is_count(lines[0][1][0]) and len(lines[0][1]) == 1 < len(lines[1][1]):
        said, lines = int(lines[0][1][0]), lines[1:]
        if said != len(lines):
            raise InputError(f"{path}: its first line says {said}, but {len(lines)} rows follow ({what})")
    width = len(lines[0][1])
    if allowed is not None and width not in allowed:
        wanted = " or ".join(str(n) for n in allowed)
        raise InputError(f"{path}: line {lines[0][0]} has {width} values, {wanted} are needed ({what})")
    rows: list[list[float]] = []
    for i, words in lines:
        if len(words) != width:
            raise InputError(f"{path}: line {i} has {len(words)} values, {width} are needed ({what})")
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            raise InputError(f"{path}: line {i} is not a row of numbers ({what})") from None
    table = np.array(rows, dtype=np.float64)
    finite = np.isfinite(table).all(axis=1)
    if not finite.all():
        raise InputError(f"{path}: line {lines[int(np.argmin(finite))][0]} holds a value that is not finite ({what})")
    return table


_silence = threading.Lock()
_silenced: list[tuple[IO[bytes], list[tuple[int, int]], io.StringIO, tuple[TextIO, TextIO]]] = []
_inside = 0


@contextmanager
def library_silenced() -> Iterator[Callable[[], str]]:
    """Keep what a C library prints on the file descriptors 1 and 2 off the terminal; the function handed out returns that text.

    On a damaged file libjpeg, libpng, libtiff and OpenEXR print lines of their own, and for some damage that is the only sign
    they give. May be entered by several threads at once: the first redirects, the last restores, and each then sees the others'
    output too.
    """
    global _inside
    with _silence:
        if _inside == 0:
            for stream in (sys.stdout, sys.stderr):
                if stream is not None:
                    stream.flush()
            _flush_c()
            sink: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - outlives this block where a second thread is inside
            kept = [(fd, os.dup(fd)) for fd in (1, 2) if _is_open(fd)]
            for fd, _ in kept:
                os.dup2(sink.fileno(), fd)
            # pybind11 prints through Python's own streams, which need not stand on the descriptors.
            text = io.StringIO()
            _silenced.append((sink, kept, text, (sys.stdout, sys.stderr)))
            sys.stdout = sys.stderr = text
        _inside += 1
        number, text = _silenced[-1][0].fileno(), _silenced[-1][2]
        start, start_of_text = os.fstat(number).st_size, text.tell()
    try:
        yield lambda: os.pread(number, 100_000, start).decode("utf-8", "replace") + text.getvalue()[start_of_text:]
    finally:
        with _silence:
            _inside -= 1
            if _inside == 0:
                _flush_c()
                sink, kept, _, (out, err) = _silenced.pop()
                sys.stdout, sys.stderr = out, err
                for fd, copy in kept:
                    os.dup2(copy, fd)
                    os.close(copy)
                sink.close()


def _flush_c() -> None:
    """Empty the C library's own buffers: what it was told to print while silenced would otherwise come out later."""
    ctypes.CDLL(None).fflush(None)


def _is_open(fd: int) -> bool:
    try:
        os.fstat(fd)
    except OSError:
        return False
    return True


def write_json(path: Path, value: object) -> None:
    """`value` as indented JSON (numpy scalars and arrays allowed; NaN becomes null), by a temporary name."""
    with writing(path) as temporary:
        temporary.write_text(dumps(value, indent=2) + "\n", encoding="utf-8")


def dumps(value: object, indent: int | None = None) -> str:
    """JSON text of plain values and numpy ones; NaN and infinity become null, so that any parser reads it."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False, ensure_ascii=False)


def read_json(path: Path, what: str) -> Any:
    """The JSON of a file of at most 50 MB. Raises InputError where it is missing, not JSON, or gives a key twice."""
    must_exist(path, what)
    try:
        if path.stat().st_size > 50_000_000:
            raise InputError(f"{path}: is too large ({what})")
        return json.loads(path.read_text(encoding="utf-8"), object_pairs_hook=no_key_twice)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}; {what})") from error
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is not valid JSON ({what}): {error}") from error


def no_key_twice(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """For json.loads(object_pairs_hook=...): the table of an object; ValueError where it gives a key twice."""
    table = dict(pairs)
    if len(table) != len(pairs):
        twice = Counter(key for key, _ in pairs).most_common(1)[0][0]
        raise ValueError(f"the key {twice!r:.80} is there twice")
    return table


def _plain(value: Any) -> Any:
    if isinstance(value, str):
        return printable(value)
    if isinstance(value, dict):
        return {_plain(str(key)): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if isinstance(value, Path):
        return _plain(str(value))
    return value


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
