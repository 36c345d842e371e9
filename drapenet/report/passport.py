"""A fabric's passport in its report: a line with identity and key figures of its estimate, and a QR
code of the address of the page that shows it, or of the line where there is none."""

import io
from dataclasses import dataclass

import segno

from common.errors import shortened
from drapenet.result.document import EstimateDocument

SIDE = 24  # mm, of the code
_MAX_NAME = 40  # characters of a fabric's name in the code
_PIXELS, _BORDER = 6, 2  # of a module of the code, and modules around it


@dataclass(frozen=True)
class Passport:
    """Line of a fabric, and the address of its page, if any."""

    line: str
    address: str = ""

    @classmethod
    def of(cls, name: str, document: EstimateDocument, address: str = "") -> "Passport":
        """Of an estimate."""
        moduli = document.moduli.values()
        alpha, beta = (" ".join(quantity.texts()[0] for quantity in found) for found in (
            [each.alpha_uN_m for each in moduli], [each.beta_nN_m2 for each in moduli]))
        about = document.capture
        named = name.endswith(f" {about.density_g_m2:g} g/m²")  # a fabric without a name, by it
        parts = [f"DrapeNet {document.identity}", shortened(name, _MAX_NAME),
                 *[f"{about.density_g_m2:g} g/m2"] * (not named),
                 f"{' '.join(document.names)}: alpha {alpha} uN m, beta {beta} nN m2"]
        if about.drape_coefficient_percent is not None:
            parts.append(f"drape coefficient {about.drape_coefficient_percent:g} %")
        return cls("; ".join(parts), address)

    @property
    def code(self) -> bytes:
        """The QR code as PNG."""
        stream = io.BytesIO()
        segno.make(self.address or self.line, error="m", micro=False).save(
            stream, kind="png", scale=_PIXELS, border=_BORDER)
        return stream.getvalue()
