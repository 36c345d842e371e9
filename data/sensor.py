"""What a depth sensor adds to perfect pictures: models and settings by name."""

from collections.abc import Mapping
from dataclasses import fields

from common.configs import read_option
from common.errors import InputError
from data.sensor_noise import SensorNoise
from data.structured_light import StructuredLight
from data.time_of_flight import TimeOfFlight

MODELS: dict[str, type[SensorNoise]] = {
    "structured_light": StructuredLight,  # that of the paper
    "time_of_flight": TimeOfFlight,
}


def load_sensor(name: str = "smooth") -> SensorNoise:
    """Read ``configs/sensor/NAME.yaml``; InputError when there is no such file."""
    return sensor_from_config(read_option("sensor", name))


def sensor_from_config(config: Mapping) -> SensorNoise:
    """Build from the mapping of a sensor file (Hydra's group ``sensor`` gives the same).

    Raises:
        InputError: an unknown model or setting, or a value out of range.
    """
    settings = dict(config)
    name = settings.pop("model", "structured_light")
    if name not in MODELS:
        raise InputError(f"unknown sensor.model '{name}'; known: {', '.join(MODELS)}")
    unknown = set(settings) - {field.name for field in fields(MODELS[name])}
    if unknown:
        raise InputError(f"unknown sensor setting '{min(unknown)}'; see configs/sensor")
    return MODELS[name](**settings)
