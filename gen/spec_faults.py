"""The faults of a capture's spec: what a real set-up gets wrong about its lights and what a sensor adds. `gen.faults` applies them."""

from __future__ import annotations

from typing import Literal

from pydantic import Field, model_validator

from gen.spec_parts import Number, Part, Whole


class Noise(Part):
    """Noise of a sensor, independent in every sample and channel."""

    read: Number = Field(default=0.0, ge=0, le=1, description="standard deviation of the read noise, in units of full scale")
    photons: Number | None = Field(
        default=None, ge=1, le=1e9, description="electrons of a full well: shot noise; left out, light comes without"
    )


class Faults(Part):
    """What is wrong with the pictures and with what is said of their lights. Everything is 0, none, unless asked for.

    Full scale is 1, where `clip` cuts. The truth's layers stay as they are.
    """

    light_direction_degrees: Number = Field(
        default=0.0, ge=0, le=45, description="root mean square of the angle from the true directions to the stated ones"
    )
    light_intensity: Number = Field(
        default=0.0, ge=0, le=1, description="relative standard deviation of the stated intensities, one draw a light"
    )
    ambient: Number = Field(
        default=0.0, ge=0, le=10, description="radiance of even light from everywhere, as a share of the lights' mean intensity"
    )
    noise: Noise = Noise()
    black_level: Number = Field(default=0.0, ge=0, lt=1, description="what the sensor reads in the dark, in units of full scale")
    bits: Whole | None = Field(
        default=None, ge=1, le=16, description="whole numbers of so many bits; this cuts at full scale too"
    )
    encoding: Literal["linear", "srgb"] | None = Field(
        default=None, description="of the whole numbers (default linear); the capture holds what they stand for, linear"
    )

    @model_validator(mode="after")
    def _encoding_is_of_bits(self) -> Faults:
        if self.encoding is not None and self.bits is None:
            raise ValueError("encoding says what whole numbers mean; it needs bits")
        return self
