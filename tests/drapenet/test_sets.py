"""Captures that contradict the others are named, repeats of one fabric are not."""

import numpy as np

from drapenet.sets import SPECIMEN, contradictions
from sim.material import DIRECTIONS

PRIOR, ERROR = 0.9, 0.15  # standard deviations of log alpha, over fabrics and of a capture
SPREAD = np.array([PRIOR] * 3 + [1.4e-3] * 3)


class Normal:
    """Posteriors of normal captures of one fabric, each with an observed value of log alpha."""

    def __init__(self, seen: np.ndarray) -> None:
        self.seen = seen
        self.draws = np.random.default_rng(0).normal(size=(400, 6))

    def of(self, numbers: list[int]) -> np.ndarray:
        variance = 1 / (1 / PRIOR**2 + len(numbers) / ERROR**2)
        mean = variance * self.seen[numbers].sum(axis=0) / ERROR**2
        samples = self.draws.copy()
        samples[:, :3] = mean + np.sqrt(variance) * self.draws[:, :3]
        return samples

    def lines(self, labels: str) -> list[str]:
        alone = [self.of([k]) for k in range(len(self.seen))]
        return contradictions(alone, self.of, labels, names=DIRECTIONS, spread=SPREAD, density=0.2)


def test_captures_of_another_fabric_are_named_and_no_other() -> None:
    same, other = np.zeros(3), np.full(3, 1.2)
    line, = Normal(np.array([same, same, other])).lines("ABC")
    assert line.startswith("C contradicts the other 2 captures: alpha ")
    line, = Normal(np.array([same, other])).lines("AB")
    assert "contradicts" in line and "limit 11.3" in line
    assert {text[0] for text in Normal(np.array([same, other, same, other, same])).lines(
        "ABCDE")} == {"B", "D"}


def test_repeats_contradict_each_other_as_rarely_as_is_stated() -> None:
    rng, alarms = np.random.default_rng(3), {2: 0, 4: 0}
    for count in alarms:
        for _ in range(400):
            fabric = PRIOR * rng.normal(size=3)
            errors = np.hypot(ERROR, SPECIMEN) * rng.normal(size=(count, 3))
            alarms[count] += bool(Normal(fabric + errors).lines("ABCD"[:count]))
    assert all(share <= 12 for share in alarms.values())  # 4 expected of 400
