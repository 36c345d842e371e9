"""From depth images in metres to the network's input: one function for training and inference."""

from dataclasses import asdict, dataclass

import numpy as np
import torch
import torch.nn.functional as functional

from common.errors import InputError

LARGEST_CUT = 0.5
"""Share of the cloth outside of the network's window beyond which there is no estimate."""


@dataclass(frozen=True)
class InputFormat:
    """What the network sees of a view; stored in every checkpoint.

    Attributes:
        width, height: pixels of the network's input.
        centre: depth that becomes 0, m.
        scale: depth difference that becomes 1, m.
        crop_width, crop_height: window around the cloth that is kept, pixels of the views; 0 keeps
            the whole picture. Most of a view is background, which costs as much as cloth.
        background: value of a pixel without cloth; "behind everything", so that depth and
            silhouette point the same way.
    """

    width: int = 120
    height: int = 90
    centre: float = 0.535
    scale: float = 0.1
    background: float = 2.0
    crop_width: int = 0
    crop_height: int = 0

    def __post_init__(self) -> None:
        if self.width < 32 or self.height < 24:
            raise InputError(
                f"network input {self.width}x{self.height} is too small; use at least 32x24"
            )
        if self.crop_width < 0 or self.crop_height < 0:
            raise InputError("the crop of the network's input must not be negative")
        if not self.scale > 0:
            raise InputError("the depth scale of the network's input must be positive")

    def as_dict(self) -> dict:
        """All fields, in JSON's types."""
        return asdict(self)


def prepare(views: torch.Tensor, *, form: InputFormat) -> torch.Tensor:
    """Crop, shrink and normalise depth images.

    A pixel of the result is the mean of the cloth's pixels in its area, and background if less
    than half of the area is cloth, so that a silhouette never becomes a ramp of depths between
    the cloth and nothing.

    Args:
        views: (..., V, H, W) z-depth in m, 0 (or anything not positive) is background. The V
            views of a capture are cropped alike.
        form: the size and normalisation.

    Returns:
        (..., V, height, width) float32, without unit.
    """
    views = _crop(views, form).to(torch.float32)
    flat = views.reshape(-1, 1, *views.shape[-2:])
    cloth = (flat > 0).to(torch.float32)
    size = (form.height, form.width)
    coverage = functional.interpolate(cloth, size=size, mode="area")
    depth = functional.interpolate(flat * cloth, size=size, mode="area")
    depth = depth / coverage.clamp_min(1e-6)
    values = (depth - form.centre) / form.scale
    values = torch.where(coverage >= 0.5 - 1e-6, values, torch.full_like(values, form.background))
    return values.reshape(*views.shape[:-2], *size)


def crop_doubts(views: np.ndarray, *, form: InputFormat) -> list[str]:
    """What to report, a line each, of cloth in a capture (4, H, W) that the network cannot see.

    Raises:
        InputError: it is more than :data:`LARGEST_CUT`.
    """
    whole = torch.from_numpy(views > 0)
    seen = _crop(whole, form)
    cut = 1 - int(seen.sum()) / max(int(whole.sum()), 1)
    if not cut:
        return []
    rows, columns = (whole.any(dim=0).any(dim=axis).nonzero() for axis in (1, 0))
    width, height = (int(line.max() - line.min()) + 1 for line in (columns, rows))
    found = (f"the cloth is {width} x {height} pixels of {views.shape[2]} x {views.shape[1]}, the "
             f"network sees {seen.shape[2]} x {seen.shape[1]} around its middle: {cut:.1%} of the "
             "cloth is cut off")
    remedy = ("check that only cloth is left in the pictures, and their intrinsics, or choose a "
              "checkpoint with a larger window")
    if cut > LARGEST_CUT:
        raise InputError(f"{found}, and at most {LARGEST_CUT:.0%} may be; {remedy}")
    return [f"{found}, and the estimate may be wrong; {remedy}"]


def _crop(views: torch.Tensor, form: InputFormat) -> torch.Tensor:
    """The windows of the views (..., V, H, W) in whose middle each capture's cloth is."""
    if not (form.crop_width or form.crop_height):
        return views
    captures = views.reshape(-1, *views.shape[-3:])
    cloth = (captures > 0).any(dim=1)
    size = [min(kept or whole, whole) for kept, whole in
            zip((form.crop_height, form.crop_width), views.shape[-2:], strict=True)]
    # One transfer for all captures: on a GPU each would wait for what is under way.
    corners = torch.stack([_first(cloth.any(dim=2), size[0]), _first(cloth.any(dim=1), size[1])])
    windows = [capture[:, top : top + size[0], left : left + size[1]]
               for capture, top, left in zip(captures, *corners.tolist(), strict=True)]
    return torch.stack(windows).reshape(*views.shape[:-2], *size)


def _first(lines: torch.Tensor, kept: int) -> torch.Tensor:
    """First lines (B,) of windows of ``kept`` lines around the true ones (B, N) in the middle."""
    size = lines.shape[1]
    first = lines.to(torch.uint8).argmax(dim=1)
    last = size - 1 - lines.flip(1).to(torch.uint8).argmax(dim=1)
    # Without cloth these are the ends of the picture, and its middle is the window's.
    return ((first + last + 1 - kept) / 2).round().long().clamp(0, size - kept)
