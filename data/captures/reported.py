"""What a laboratory knows already of a captured fabric: the key ``known`` of ``capture.yaml``."""

from typing import Annotated

from pydantic import Field

from data.readings.known import Known


class Reported(Known):
    """Values of testers, and what a drape tester without pictures reports."""

    drape_coefficient_percent: Annotated[float, Field(gt=0, lt=100)] | None = None
    nodes: Annotated[int, Field(ge=0, le=30)] | None = None
