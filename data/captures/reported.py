"""What a laboratory knows already of a captured fabric: the key ``known`` of ``capture.yaml``."""

from pydantic import Field

from data.readings.known import Known


class Reported(Known):
    """Values of testers, and what a drape tester without pictures reports."""

    drape_coefficient_percent: float | None = Field(
        None, gt=0, lt=100, title="of a capture without pictures")
    nodes: int | None = Field(None, ge=0, le=30, title="number of its folds")
