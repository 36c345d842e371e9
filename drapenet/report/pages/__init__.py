"""HTML pages from the templates in this folder."""

from base64 import b64encode
from functools import cache
from pathlib import Path
from urllib.parse import quote

import jinja2

from sim.rig import Rig


def render(template: str, **values: object) -> bytes:
    """A page in UTF-8; values are escaped unless marked as safe, a missing name is an error."""
    return _environment().get_template(template).render(values).encode(errors="replace")


def in_words(names: str) -> str:
    """Testers, names with commas, in words."""
    rigs = [Rig.from_name(name) for name in names.split(", ")]
    return "; ".join(f"{rig.specimen} of {rig.millimetres} mm on a plate of "
                     f"{1e3 * rig.plate_diameter:g} mm"
                     + f" with a rim rounded by {1e3 * rig.rim:g} mm" * (rig.rim > 0)
                     for rig in rigs)


@cache
def _environment() -> jinja2.Environment:
    pages = jinja2.Environment(loader=jinja2.PackageLoader("drapenet", "report/pages"),
                               autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True)
    pages.filters |= {"address": lambda path: quote(Path(path).as_posix()),
                      "base64": lambda data: b64encode(data).decode(), "tester": in_words}
    return pages
