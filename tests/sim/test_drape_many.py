"""Many drapes at once: order, failure as data, the same bytes on any number of cores."""

import numpy as np
import pytest

from common.errors import InputError
from sim.cloth import Laws
from sim.energies.external import Gravity
from sim.many import drape_many
from sim.material import Fabric
from sim.rig import DISC_RIG
from sim.solver.newton import Status

ALPHAS = (60e-6, 20e-6, 40e-6)


class Raising(Gravity):
    """An energy whose value cannot be computed."""

    def value(self, q: np.ndarray) -> float:
        raise FloatingPointError("no value")


def raising(mesh, active, *, fabric):
    return Raising(mesh, density=fabric.density, gravity=9.81)


def plan(alpha: float, **options: object) -> dict:
    start = "lowered" if alpha == ALPHAS[0] else "sine"
    return {"fabric": Fabric(np.full(3, alpha)), "rig": DISC_RIG, "edge": 12e-3,
            "start": start} | options


@pytest.fixture(scope="module")
def two():
    broken = plan(30e-6, laws=Laws(others=(raising,)))
    return drape_many([*map(plan, ALPHAS), broken], workers=2)


def test_drapes_are_in_order_and_one_that_fails_is_a_status(two):
    assert [one.fabric.alpha[0] for one in two] == [*ALPHAS, 30e-6]
    assert [one.status for one in two] == [Status.CONVERGED] * 3 + [Status.EXCEPTION]
    assert two[3].message == "FloatingPointError: no value"
    assert not two[3].positions[:, 2].any()


@pytest.mark.parametrize(("plans", "options", "word"), [
    (Fabric(np.full(3, 6e-5)), {}, "plans are a list .*'Fabric' object is not iterable"),
    ([Fabric(np.full(3, 6e-5))], {}, "must be a mapping"), (plan(6e-5), {}, "must be a mapping"),
    ([plan(6e-5, sed=1)], {}, "unexpected keyword argument 'sed'"),
    ([{"edge": 12e-3}], {}, "missing a required argument: 'fabric'"),
    ([plan(6e-5)], {"workers": "2"}, "workers='2'"), ([plan(6e-5)], {"workers": 0}, "workers=0")])
def test_other_plans_are_refused_before_any_work(plans, options, word):
    with pytest.raises(InputError, match=word):
        drape_many(plans, **options)
    assert drape_many(iter(())) == []


def test_one_core_gives_the_same_bytes_as_two(two):
    for one, other in zip(drape_many(list(map(plan, ALPHAS))), two, strict=False):
        assert one.positions.tobytes() == other.positions.tobytes()
