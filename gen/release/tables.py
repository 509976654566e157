"""The tables of a release: their columns, and Parquet files that depend on nothing but the rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gen.errors import InputError

PICTURES: Mapping[str, tuple[str, str]] = {
    "item": ("string", "id of the capture, the key of its sample"),
    "picture": ("int32", "number of the picture in the capture, from 1"),
    "pictures": ("int32", "pictures of the capture, K"),
    "group": ("string", "group of the set's spec that the capture belongs to"),
    "split": ("string", "train, validation or test"),
    "single": ("bool", "whether the capture is one training picture, screened for overexposure"),
    "shard": ("string", "file in the folder data that holds it"),
    "field": ("string", "field of the sample that holds the picture, an EXR"),
    "offset": ("int64", "first byte of that EXR in the shard"),
    "bytes": ("int64", "size of that EXR"),
    "sha256": ("string", "SHA-256 of that EXR"),
    "view_sha256": ("string", "SHA-256 of the capture's view.exr"),
    "mask_sha256": ("string", "SHA-256 of the capture's mask.png"),
    "width": ("int32", "pixels"),
    "height": ("int32", "pixels"),
    "light_kind": ("string", "sun, point, area, environment, ambient or several"),
    "light_x": ("float64", "direction to the light, unit vector, camera frame: to the right"),
    "light_y": ("float64", "up"),
    "light_z": ("float64", "to the camera"),
    "intensity_r": ("float64", "radiance of a white Lambertian surface that faces the light, linear Rec.709 red"),
    "intensity_g": ("float64", "green"),
    "intensity_b": ("float64", "blue"),
    "position_x_mm": ("float64", "place of a near light, from the point the camera looks at; empty where the light is distant"),
    "position_y_mm": ("float64", "up"),
    "position_z_mm": ("float64", "to the camera"),
    "mm_per_pixel": ("float64", "scale of an orthographic view; empty where the view is perspective"),
    "distance_mm": ("float64", "from the camera to the object's middle"),
    "shape": ("string", "family of the shape"),
    "material": ("string", "family of the material"),
    "alpha_low": ("float64", "gloss: alpha of the half-vector distribution, the least where it is a texture; 0 without gloss"),
    "alpha_high": ("float64", "the largest; equal where alpha is one number"),
    "exposure": ("float64", "factor on radiance and light alike"),
    "object_share": ("float64", "share of the frame that the object fills"),
    "overexposed_pixels": ("int64", "pixels with R, G and B at 255 in 8-bit sRGB"),
    "clipped_samples": ("int64", "pixels marked as clipped"),
    "seed": ("int64", "seed of the capture's spec"),
    "object": ("string", "key of the object: equal for equal shapes"),
    "material_key": ("string", "key of the material"),
    "lights_key": ("string", "key of the set of lights"),
    "spec_sha256": ("string", "SHA-256 of the capture's spec with all defaults"),
    "blender": ("string", "Blender, and with it Cycles, that rendered"),
    "device": ("string", "what it rendered on"),
}
"""Columns of pictures.parquet: type and meaning."""

REJECTED: Mapping[str, tuple[str, str]] = {
    "item": ("string", "id of the capture in the plan"),
    "picture": ("int32", "number of the picture in the capture, from 1"),
    "group": ("string", "group of the set's spec that the capture belongs to"),
    "split": ("string", "what the plan says of its split; empty where it left that open"),
    "reason": ("string", "why it was left out"),
    "overexposed_pixels": ("int64", "pixels with R, G and B at 255 in 8-bit sRGB"),
    "clipped_samples": ("int64", "pixels marked as clipped"),
    "error": ("string", "why it could not be rendered"),
    "shape": ("string", "family of the shape"),
    "material": ("string", "family of the material"),
    "seed": ("int64", "seed of the capture's spec"),
    "spec_sha256": ("string", "SHA-256 of the capture's spec with all defaults"),
}
"""Columns of rejected.parquet."""

MEMBERS: Mapping[str, tuple[str, str]] = {
    "shard": ("string", "file in the folder data"),
    "item": ("string", "key of the sample"),
    "field": ("string", "field of the sample; the file's name is item.field"),
    "offset": ("int64", "first byte in the shard"),
    "bytes": ("int64", "size"),
    "sha256": ("string", "SHA-256"),
}
"""Columns of members.parquet."""

Columns = Mapping[str, tuple[str, str]]
BATCH = 4096
"""Rows that are in memory at a time; a table's row groups hold so many at most."""

MAX_BYTES = 4_000_000_000
MAX_GROUP = 256_000_000
"""The largest table, and the most that one of its row groups may unpack to, in bytes."""


@contextmanager
def table_writer(path: Path, columns: Columns) -> Iterator[Any]:
    """A function that appends rows (mappings of exactly the columns) to a new Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    schema = _schema(columns)
    waiting: list[Mapping[str, Any]] = []
    with pq.ParquetWriter(path, schema, compression="zstd", version="2.6") as writer:

        def flush() -> None:
            writer.write_table(pa.Table.from_pylist(waiting, schema=schema), row_group_size=BATCH)
            waiting.clear()

        def append(rows: Iterable[Mapping[str, Any]]) -> None:
            for row in rows:
                waiting.append(row)
                if len(waiting) == BATCH:
                    flush()

        yield append
        if waiting:
            flush()


def read_table(path: Path, columns: Columns) -> Iterator[dict[str, Any]]:
    """The rows of a table, some at a time. Raises InputError where it is damaged, has other columns or is too large."""
    for group in _groups(path, columns):
        yield from group.to_pylist()


def read_rows(path: Path, columns: Columns, item: str) -> list[dict[str, Any]]:
    """The rows of one item. Raises InputError as `read_table` does."""
    import pyarrow.compute as pc

    return [row for group in _groups(path, columns) for row in group.filter(pc.equal(group["item"], item)).to_pylist()]


def _groups(path: Path, columns: Columns) -> Iterator[Any]:
    """The row groups of a table, each as a pyarrow table."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    if not path.is_file() or path.stat().st_size > MAX_BYTES:
        raise InputError(f"{path}: is missing or larger than {MAX_BYTES // 10**9} GB")
    try:
        with pq.ParquetFile(path) as file:
            if not file.schema_arrow.equals(_schema(columns)):
                raise InputError(f"{path}: has other columns than a release of this version")
            for group in range(file.num_row_groups):
                meta = file.metadata.row_group(group)
                if meta.num_rows > BATCH or meta.total_byte_size > MAX_GROUP:
                    raise InputError(f"{path}: row group {group} is larger than a release has them")
                yield file.read_row_group(group)
    except (pa.ArrowException, OSError) as error:
        raise InputError(f"{path}: is not a table that can be read ({' '.join(str(error).split())[:200]})") from error


def concatenate(parts: Sequence[Path], path: Path, columns: Columns) -> int:
    """Write the rows of several tables into one; how many."""
    count = 0
    with table_writer(path, columns) as append:
        for part in parts:
            for row in read_table(part, columns):
                append((row,))
                count += 1
    return count


def _schema(columns: Columns) -> Any:
    import pyarrow as pa

    return pa.schema([pa.field(name, pa.type_for_alias(kind)) for name, (kind, _) in columns.items()])
