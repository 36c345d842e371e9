"""Do tests depend on the last bits of a start? ``make perturbed``.

    python tests/perturbed.py [key=value ...]

Rounding differs between processors, and falling cloth passes through instabilities: a test that
reaches a drape in two ways may pass on one processor and fail on another. So the tests run once
unchanged. Then those files whose tests search for equilibria run again and again, every search from
some 1e-9 m beside its start (the same for equal starts). Tests whose outcome changes are listed,
and the command fails. Such a test has to start next to a minimum, to compare what must agree, or to
use another case. Searches in worker processes are not perturbed.
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import zlib  # noqa: E402
from collections import Counter  # noqa: E402
from dataclasses import asdict, dataclass  # noqa: E402

import numpy as np  # noqa: E402
import pytest  # noqa: E402

import sim.equilibrium  # noqa: E402
from common.command import command  # noqa: E402
from common.errors import InputError  # noqa: E402
from common.files import replace_json, require_file  # noqa: E402
from experiments.result import machine, table  # noqa: E402
from sim.solver.newton import NewtonResult, minimise  # noqa: E402
from sim.solver.potential import Potential  # noqa: E402


@dataclass
class PerturbedConfig:
    """``configs/perturbed.yaml``."""

    times: int
    size: float
    seed: int
    tests: str
    marks: str
    out: str


class Perturbation:
    """A plugin of pytest for one run: perturbs searches and keeps what comes of the tests.

    Args:
        seed: of the perturbations; None for a run without any.
        size: m.

    Attributes:
        outcomes: by test, "passed" unless its set-up, call or tear-down ended otherwise.
        searching: files whose tests search for equilibria.
    """

    def __init__(self, seed: int | None, size: float) -> None:
        self._seed, self._size, self._file = seed, size, ""
        self.outcomes: dict[str, str] = {}
        self.searching: set[str] = set()

    def minimise(self, potential: Potential, start: np.ndarray, *options: object) -> NewtonResult:
        """As :func:`sim.solver.newton.minimise`, from beside the ``start``."""
        self.searching.add(self._file)
        if self._seed is not None:
            rng = np.random.default_rng([self._seed, zlib.crc32(start.tobytes())])
            move = np.zeros(potential.unknowns)
            # Normals follow their edges: only coordinates are moved.
            coordinates = potential.unknowns - (len(start) - potential.unknowns) // 2
            move[:coordinates] = self._size * rng.standard_normal(coordinates)
            start = potential.moved(start, potential.free_unknowns(move))
        return minimise(potential, start, *options)

    def pytest_runtest_protocol(self, item: pytest.Item) -> None:
        """Remember whose searches follow, those of its fixtures among them."""
        self._file = item.nodeid.split("::")[0]

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep the outcome of a test's set-up, call and tear-down together."""
        if self.outcomes.get(report.nodeid, "passed") == "passed":
            self.outcomes[report.nodeid] = report.outcome


def run_tests(words: list[str], seed: int | None, size: float) -> Perturbation:
    """One run of the tests that ``words`` of pytest's command line choose."""
    plugin = Perturbation(seed, size)
    sim.equilibrium.minimise = plugin.minimise
    try:
        ended = pytest.main(["-q", "--no-header", "--no-summary", "--tb=no", *words],
                            plugins=[plugin])
    finally:
        sim.equilibrium.minimise = minimise
    if ended == pytest.ExitCode.INTERRUPTED:
        raise KeyboardInterrupt
    if ended not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        raise InputError(f"pytest {' '.join(words)} runs no tests; it says why")
    return plugin


def compare(plain: dict[str, str], perturbed: list[dict[str, str]]) -> dict[str, dict]:
    """Tests whose outcome changes: as they are, and how often what came of them."""
    changed = {}
    for test, outcome in plain.items():
        found = Counter(run[test] for run in perturbed if test in run)
        if set(found) - {outcome}:
            changed[test] = {"unperturbed": outcome, "perturbed": dict(found)}
    return changed


@command("perturbed", PerturbedConfig)
def main(config: PerturbedConfig) -> None:
    """Run the tests, print what changes, write the report."""
    require_file(Path(config.out))
    marks = ["-m", config.marks]
    plain = run_tests([*marks, *config.tests.split(",")], None, 0.0)
    files = sorted(plain.searching)
    runs = [run_tests([*marks, *files], config.seed + k, config.size).outcomes
            for k in range(config.times if files else 0)]
    changed = compare(plain.outcomes, runs)
    tests = sum(test.split("::")[0] in files for test in plain.outcomes)
    print(table(["test", "unperturbed", "perturbed"],
                [[test, c["unperturbed"], ", ".join(f"{k} {n}" for k, n in c["perturbed"].items())]
                 for test, c in changed.items()]))
    print(f"perturbed: {len(changed)} of {tests} tests change their outcome "
          f"({len(runs)} runs, {config.size:g} m)")
    replace_json(Path(config.out), {
        "machine": machine(), "settings": asdict(config), "files": files, "tests": tests,
        "changed": changed,
        "failed_unperturbed": [t for t, o in plain.outcomes.items() if o == "failed"]})
    if changed:
        sys.exit(1)


if __name__ == "__main__":
    main()
