"""COLMAP in a process of its own: `python -m recon.multiview.colmap FOLDER`, started by `recon.multiview.structure`.

FOLDER holds problem.json, a list of {"file", "K"}, pictures/FILE and masks/FILE.png; poses.json is written there:
{"poses": [{"file", "matrix": (3, 4) world to OpenCV camera}], "points": (N, 3), "error": pixels}.
"""

from __future__ import annotations

import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any


def solve(folder: Path) -> dict[str, Any]:
    """The largest reconstruction that COLMAP finds. K stays as it is given; COLMAP's own pixel centres lie at halves."""
    pycolmap: Any = import_module("pycolmap")  # an extra, without type hints of its own
    database = folder / "database.db"
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    extraction.sift.first_octave = -1
    extraction.sift.peak_threshold = 0.003
    for entry in json.loads((folder / "problem.json").read_text(encoding="utf-8")):
        K = entry["K"]
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = "PINHOLE"
        reader.camera_params = ",".join(str(v) for v in (K[0][0], K[1][1], K[0][2] + 0.5, K[1][2] + 0.5))
        reader.mask_path = str(folder / "masks")
        pycolmap.extract_features(
            database,
            folder / "pictures",
            image_names=[entry["file"]],
            camera_mode=pycolmap.CameraMode.PER_IMAGE,
            reader_options=reader,
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )
    pycolmap.match_exhaustive(database, device=pycolmap.Device.cpu)
    options = pycolmap.IncrementalPipelineOptions()
    options.ba_refine_focal_length = options.ba_refine_principal_point = options.ba_refine_extra_params = False
    options.random_seed = 0
    (folder / "models").mkdir()
    models = pycolmap.incremental_mapping(database, folder / "pictures", folder / "models", options)
    if not models:
        return {"poses": [], "points": [], "error": 0.0}
    best = max(models.values(), key=lambda model: model.num_reg_images())
    placed = [image for image in best.images.values() if image.has_pose]
    return {
        "poses": [{"file": image.name, "matrix": image.cam_from_world().matrix().tolist()} for image in placed],
        "points": [point.xyz.tolist() for point in best.points3D.values()],
        "error": best.compute_mean_reprojection_error(),
    }


if __name__ == "__main__":
    place = Path(sys.argv[1])
    (place / "poses.json").write_text(json.dumps(solve(place)), encoding="utf-8")
