"""Noise models of depth sensors by name, with the settings of ``configs/sensor``."""

from collections.abc import Mapping
from functools import cache

from common.configs import read_option
from common.errors import InputError
from data.render.sensor_noise import SensorNoise
from data.render.structured_light import StructuredLight
from data.render.time_of_flight import TimeOfFlight

MODELS: dict[str, type[SensorNoise]] = {
    "structured_light": StructuredLight,  # as in Feng et al. 2022
    "time_of_flight": TimeOfFlight,
}


@cache
def load_sensor(name: str = "smooth") -> SensorNoise:
    """Read ``configs/sensor/NAME.yaml``; InputError when there is no such file."""
    return sensor_from_config(read_option("sensor", name))


def sensor_from_config(config: Mapping) -> SensorNoise:
    """Build from the mapping of a sensor file.

    Raises:
        InputError: an unknown model or setting, or a value out of range.
    """
    settings = dict(config)
    name = settings.pop("model", "structured_light")
    if name not in MODELS:
        raise InputError(f"unknown sensor.model '{name}'; known: {', '.join(MODELS)}")
    return MODELS[name].of(settings, "sensor")
