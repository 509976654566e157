"""The materials of a capture's spec, by kind, and the textures that may stand for their values. `job()` is the studio's entry.

Colours are `albedo` (of the matte twin) and `specular`; gloss is `alpha` of the half-vector distribution, where a kind has no other name
for it. What each kind means is written in `blender_scenes.materials`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BaseModel, Discriminator, Field, Tag, model_validator

from gen.spec_lights import Light, Several
from gen.spec_parts import Colour, Number, Part, Reflectance, Whole, YesNo
from gen.substrate import alpha_from_roughness


class Texture(Part):
    """A solid pattern in the object's frame, between two values."""

    texture: Literal["noise", "cells", "stripes", "checker", "spots"]
    scale_mm: Number = Field(ge=0.001, le=1e6, description="size of a feature: a cell, a square, a period of stripes")
    seed: Whole = Field(default=0, ge=0, lt=2**31, description="turns and shifts the pattern")
    detail: Number | None = Field(default=None, ge=0, le=8, description="octaves of noise (default 2)")
    share: Number | None = Field(default=None, ge=0.01, le=0.99, description="of high in stripes and spots (default 0.5)")

    @model_validator(mode="after")
    def _own_keys(self) -> Texture:
        if self.detail is not None and self.texture != "noise":
            raise ValueError("detail belongs to noise")
        if self.share is not None and self.texture not in ("stripes", "spots"):
            raise ValueError("share belongs to stripes and spots")
        return self

    def job(self) -> dict[str, Any]:
        plain = self.model_dump(mode="json", exclude_none=True)
        return {("scale" if key == "scale_mm" else key): value for key, value in plain.items()}


class ColourTexture(Texture):
    """A texture of reflectance."""

    low: Reflectance
    high: Reflectance


class NumberTexture(Texture):
    """A texture of alpha."""

    low: Number
    high: Number


def _branch(value: Any) -> str:
    return "painted" if isinstance(value, dict | Texture) else "plain"


def _between(low: float, high: float) -> AfterValidator:
    def check(value: NumberTexture) -> NumberTexture:
        if not (low <= min(value.low, value.high) and max(value.low, value.high) <= high):
            raise ValueError(f"low and high must lie from {low:.4g} to {high:.4g}")
        return value

    return AfterValidator(check)


def _phong_specular(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if min(value) < 0 or max(value) > 1e4:
        raise ValueError("must lie between 0 and 10000 in every channel")
    return value


PHONG = (math.sqrt(2 / (1e5 + 2)), math.sqrt(2 / 3))
"""Alphas of Blinn-Phong's exponents from 1e5 down to 1."""

Albedo = Annotated[
    Annotated[Reflectance, Tag("plain")] | Annotated[ColourTexture, Tag("painted")],
    Discriminator(_branch),
]
Width = Annotated[
    Annotated[Number, Field(ge=0.001, le=10), Tag("plain")] | Annotated[NumberTexture, _between(0.001, 10), Tag("painted")],
    Discriminator(_branch),
]
UnitWidth = Annotated[
    Annotated[Number, Field(ge=0.001, le=1), Tag("plain")] | Annotated[NumberTexture, _between(0.001, 1), Tag("painted")],
    Discriminator(_branch),
]
PhongWidth = Annotated[
    Annotated[Number, Field(ge=PHONG[0], le=PHONG[1]), Tag("plain")] | Annotated[NumberTexture, _between(*PHONG), Tag("painted")],
    Discriminator(_branch),
]
PhongSpecular = Annotated[Colour, AfterValidator(_phong_specular)]

ALBEDO = "diffuse reflectance, grey or [r, g, b], or a texture"
SPECULAR = "reflectance facing the surface, grey or [r, g, b]"
ALPHA = "width of the highlight, or a texture"


class Surface(Part):
    """What all kinds share. Subclasses have `kind` and the fields of the studio's entry.

    one_light: it holds under suns and point lights only, without bounces. layered: it has a specular reflectance Ks over a diffuse base,
    so that it can be rendered with Ks = 0, and taken apart into LIME's factors.
    """

    one_light: ClassVar[bool] = False
    layered: ClassVar[bool] = False

    def width(self) -> float | None:
        """Alpha of the half-vector distribution, 0 without gloss, None where it is a texture."""
        alpha = self.job().get("alpha", 0.0)
        return None if isinstance(alpha, dict) else alpha

    def job(self) -> dict[str, Any]:
        """The studio's material entry, every value resolved."""
        names = {"albedo": "diffuse"}
        return {names.get(key, key): _plain(getattr(self, key)) for key in type(self).model_fields}


def _plain(value: Any) -> Any:
    if isinstance(value, Texture):
        return value.job()
    return list(value) if isinstance(value, tuple) else value


class Substrate(Surface):
    """Glossy plastic or paint: a diffuse base under a specular coat (pbrt-v3's FresnelBlend). Defaults: pbrt's."""

    one_light: ClassVar[bool] = True
    layered: ClassVar[bool] = True

    kind: Literal["substrate"] = "substrate"
    albedo: Albedo = Field(default=(0.5, 0.5, 0.5), description=f"Kd: {ALBEDO}")
    specular: Reflectance = Field(default=(0.5, 0.5, 0.5), description=f"Ks: {SPECULAR}")
    alpha: Width | None = Field(default=None, description=f"{ALPHA}; or say roughness")
    roughness: Number | None = Field(default=None, gt=0, le=1, description="pbrt's roughness (default 0.1); or say alpha")
    remap: YesNo | None = Field(default=None, description="whether roughness is remapped to alpha as pbrt does (default true)")

    @model_validator(mode="after")
    def _one_width(self) -> Substrate:
        if self.alpha is not None and self.roughness is not None:
            raise ValueError("alpha and roughness both say how wide the highlight is; keep one of them")
        if self.alpha is not None and self.remap is not None:
            raise ValueError("remap belongs to roughness; alpha is never remapped")
        return self

    def job(self) -> dict[str, Any]:
        entry = super().job()
        roughness, remap = entry.pop("roughness"), entry.pop("remap")
        if self.alpha is None:
            roughness = 0.1 if roughness is None else roughness
            entry["alpha"] = roughness if remap is False else alpha_from_roughness(roughness)
        return entry


class ApproximateSubstrate(Surface):
    """The substrate by Cycles' own closures, for area lights, surroundings and bounces."""

    layered: ClassVar[bool] = True

    kind: Literal["approximate-substrate"]
    albedo: Albedo = Field(default=(0.5, 0.5, 0.5), description=f"Kd: {ALBEDO}")
    specular: Reflectance = Field(default=(0.5, 0.5, 0.5), description=f"Ks: {SPECULAR}")
    alpha: Number = Field(default=alpha_from_roughness(0.1), ge=0.001, le=1, description="width of the highlight")


class _Phong(Surface):
    """What both kinds of Blinn-Phong share."""

    layered: ClassVar[bool] = True

    albedo: Albedo = Field(default=(0.5, 0.5, 0.5), description=f"m_d: {ALBEDO}")
    specular: PhongSpecular = Field(default=(0.5, 0.5, 0.5), description="m_s: height of the highlight, may exceed 1")
    exponent: Number | None = Field(default=None, ge=1, le=1e5, description="s (default 32); or say alpha")
    alpha: PhongWidth | None = Field(default=None, description=f"{ALPHA}: s = 2 / alpha^2 - 2; or say exponent")
    normalised: YesNo = Field(default=False, description="whether the highlight is multiplied by (s + 8) / 8")

    @model_validator(mode="after")
    def _one_width(self) -> _Phong:
        if self.alpha is not None and self.exponent is not None:
            raise ValueError("alpha and exponent both say how wide the highlight is; keep one of them")
        return self

    def job(self) -> dict[str, Any]:
        entry = super().job()
        exponent = entry.pop("exponent")
        if self.alpha is None:
            entry["alpha"] = math.sqrt(2 / ((32.0 if exponent is None else exponent) + 2))
        return entry


class BlinnPhong(_Phong):
    """LIME's material: m_d (l.n) + m_s (h.n)^s."""

    one_light: ClassVar[bool] = True

    kind: Literal["blinn-phong"]


class BlinnPhongLobe(_Phong):
    """Blinn-Phong by Cycles' own lobe, for any light."""

    kind: Literal["blinn-phong-lobe"]


class TwoLobe(Surface):
    """A Lambertian base under a narrow and a wide GGX lobe."""

    one_light: ClassVar[bool] = True
    layered: ClassVar[bool] = True

    kind: Literal["two-lobe"]
    albedo: Albedo = Field(default=(0.5, 0.5, 0.5), description=ALBEDO)
    specular: Reflectance = Field(default=(0.05, 0.05, 0.05), description=SPECULAR)
    alpha: Width = Field(default=0.1, description=ALPHA)
    alpha2: Width = Field(default=0.4, description="the second lobe's")
    mix: Number = Field(default=0.5, ge=0, le=1, description="the second lobe's share")


class OrenNayar(Surface):
    """A rough diffuse base (clay, plaster, dust) under a GGX lobe."""

    one_light: ClassVar[bool] = True
    layered: ClassVar[bool] = True

    kind: Literal["oren-nayar"]
    albedo: Albedo = Field(default=(0.5, 0.5, 0.5), description=ALBEDO)
    specular: Reflectance = Field(default=(0.05, 0.05, 0.05), description=SPECULAR)
    alpha: Width = Field(default=0.3, description=ALPHA)
    sigma_degrees: Number = Field(default=20.0, ge=0, le=85, description="roughness of the base: spread of its facets' slopes")

    def job(self) -> dict[str, Any]:
        entry = super().job()
        entry["sigma"] = math.radians(entry.pop("sigma_degrees"))
        return entry


class Metal(Surface):
    """Bare metal: one GGX lobe of coloured reflectance; its matte twin is a Lambertian surface of that colour."""

    one_light: ClassVar[bool] = True

    kind: Literal["metal"]
    specular: Albedo = Field(default=(0.9, 0.9, 0.9), description=f"F0: {SPECULAR}, or a texture; also the twin's albedo")
    alpha: Width = Field(default=0.2, description=ALPHA)


class Principled(Surface):
    """Blender's Principled BSDF, its opaque part."""

    kind: Literal["principled"]
    albedo: Albedo = Field(default=(0.5, 0.5, 0.5), description=f"base colour: {ALBEDO}")
    alpha: UnitWidth = Field(default=0.25, description=f"the square of Blender's roughness: {ALPHA}")
    metallic: Number = Field(default=0.0, ge=0, le=1)
    ior: Number = Field(default=1.5, ge=1, le=4, description="index of refraction of the specular layer")
    coat: Number = Field(default=0.0, ge=0, le=1, description="weight of a clear coat")
    coat_alpha: Number = Field(default=0.001, ge=0.001, le=1, description="width of the coat's highlight")
    sheen: Number = Field(default=0.0, ge=0, le=1, description="weight of a velvet-like sheen")
    sheen_roughness: Number = Field(default=0.5, ge=0.05, le=1)


class Lambertian(Surface):
    """A matte surface."""

    kind: Literal["lambertian"]
    albedo: Albedo = Field(default=(0.5, 0.5, 0.5), description=ALBEDO)


MATERIALS: dict[str, type[Surface]] = {
    "approximate-substrate": ApproximateSubstrate,
    "blinn-phong": BlinnPhong,
    "blinn-phong-lobe": BlinnPhongLobe,
    "lambertian": Lambertian,
    "metal": Metal,
    "oren-nayar": OrenNayar,
    "principled": Principled,
    "substrate": Substrate,
    "two-lobe": TwoLobe,
}


def _kind(value: Any) -> str | None:
    kind = value.get("kind", "substrate") if isinstance(value, dict) else getattr(value, "kind", None)
    return kind if isinstance(kind, str) else None


Material = Annotated[
    Annotated[ApproximateSubstrate, Tag("approximate-substrate")]
    | Annotated[BlinnPhong, Tag("blinn-phong")]
    | Annotated[BlinnPhongLobe, Tag("blinn-phong-lobe")]
    | Annotated[Lambertian, Tag("lambertian")]
    | Annotated[Metal, Tag("metal")]
    | Annotated[OrenNayar, Tag("oren-nayar")]
    | Annotated[Principled, Tag("principled")]
    | Annotated[Substrate, Tag("substrate")]
    | Annotated[TwoLobe, Tag("two-lobe")],
    Discriminator(
        _kind,
        custom_error_type="material_kind",
        custom_error_message=f"must hold 'kind:' with one of {', '.join(MATERIALS)} (substrate if left out)",
    ),
]


def known_keys(given: Any) -> dict[str, tuple[str, ...]]:
    """Allowed keys of a spec's material section and of the textures in it, for the hint after an unknown one."""
    model: type[BaseModel] = MATERIALS.get(_kind(given) or "", Substrate)
    textures = [key for key, value in given.items() if isinstance(value, dict)] if isinstance(given, dict) else []
    return {
        "material": tuple(model.model_fields),
        **{f"material.{key}": tuple(ColourTexture.model_fields) for key in textures},
    }


def complaint(material: Surface, lights: Sequence[Light], bounces: int, ks0: bool, lime: bool) -> tuple[str, str] | None:
    """What a spec asks of its material in vain, as (key, message), or None. lights: of its pictures."""
    kind: str = material.kind  # type: ignore[attr-defined] # every kind has it
    single = [one.kind for light in lights for one in (light.lights if isinstance(light, Several) else (light,))]
    broad = sorted(set(single) - {"sun", "point"})
    anywhere = ", ".join(name for name, model in MATERIALS.items() if not model.one_light)
    if material.one_light and broad:
        return "material.kind", f"{kind} holds under suns and point lights only, not under {broad[0]}; take one of {anywhere}"
    if material.one_light and bounces:
        return "bounces", f"{kind} holds for direct light only; set bounces to 0 or take one of {anywhere}"
    if (ks0 or lime) and not material.layered:
        layered = ", ".join(name for name, model in MATERIALS.items() if model.layered)
        return ("ks0" if ks0 else "lime"), f"means nothing for {kind}; it needs one of {layered}"
    return None
