"""Published mean angular errors in degrees on DiLiGenT with all 96 lights, for the rows beside ours.

Least squares: R. Woodham (1980); low rank: L. Wu et al., ACCV 2010; sparse Bayesian: S. Ikehata et al., CVPR 2012, as reported in B. Shi et
al., "A benchmark dataset and evaluation for non-Lambertian and uncalibrated photometric stereo", TPAMI 2019. PS-FCN: G. Chen et al., ECCV
2018. CNN-PS: S. Ikehata, ECCV 2018. PX-Net: F. Logothetis et al., ICCV 2021.
"""

from __future__ import annotations

OBJECTS = ("ball", "bear", "buddha", "cat", "cow", "goblet", "harvest", "pot1", "pot2", "reading")

ROWS: dict[str, tuple[float, ...]] = {
    "least squares": (4.10, 8.39, 14.92, 8.41, 25.60, 18.50, 30.62, 8.89, 14.65, 19.80),
    "low rank (WG10)": (2.06, 6.50, 10.91, 6.73, 25.89, 15.70, 30.01, 7.18, 13.12, 15.39),
    "sparse Bayesian (IW12)": (2.54, 7.32, 11.11, 7.21, 25.70, 16.25, 29.26, 7.74, 14.09, 16.17),
    "PS-FCN": (2.82, 7.55, 7.91, 6.16, 7.33, 8.60, 15.85, 7.13, 7.25, 13.33),
    "CNN-PS": (2.12, 8.30, 8.07, 4.38, 7.92, 7.42, 14.08, 5.37, 6.38, 12.12),
    "PX-Net": (2.03, 4.13, 7.61, 4.39, 4.69, 6.90, 13.10, 5.08, 5.10, 10.26),
}


def published(names: list[str]) -> dict[str, dict[str, float]]:
    """Row -> object -> error, of the objects among the names (DiLiGenT's own folder names end in PNG); empty where there is none."""
    there = {name: name.removesuffix("PNG").lower() for name in names}
    columns = {name: OBJECTS.index(plain) for name, plain in there.items() if plain in OBJECTS}
    return {row: {name: values[i] for name, i in columns.items()} for row, values in ROWS.items()} if columns else {}
