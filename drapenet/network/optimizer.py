"""Optimiser of the network: Muon for its hidden layers, AdamW for the rest."""

import math
from collections.abc import Callable
from typing import Any

import torch

from drapenet.network.model import Network

_DECAY_OF_EXPECTED = 0.01
"""Weight decay of the few layers that say how drapes of a cloth look: with that of the posterior's
network they expect too little of captures of rare kinds, such as single views."""


def multiplies_bfloat16(device: torch.device) -> bool:
    """Whether a device multiplies in bfloat16; others imitate it, ten times more slowly."""
    able = torch.cpu.get_capabilities()
    return device.type != "cpu" or any(able.get(name) for name in ("avx512_bf16", "amx_bf16"))


class _Muon(torch.optim.Muon):
    """That of torch, whose Newton-Schulz steps are in bfloat16; here in single precision on
    processors that do not multiply bfloat16."""

    @torch.no_grad()
    def step(self, closure: Callable[[], float] | None = None) -> float | None:  # type: ignore[override]
        """A step along the gradients."""
        group, = self.param_groups
        if multiplies_bfloat16(group["params"][0].device):
            return super().step(closure)
        first, second, third = group["ns_coefficients"]
        for part in group["params"]:
            if part.grad is None:
                continue
            momentum = self.state[part].setdefault("momentum_buffer", torch.zeros_like(part))
            momentum.lerp_(part.grad, 1 - group["momentum"])
            wide = part.grad.lerp(momentum, group["momentum"])
            tall = len(wide) > wide.shape[1]
            wide = wide.T if tall else wide
            wide = wide / wide.norm().clamp(min=group["eps"])
            for _ in range(group["ns_steps"]):
                gram = wide @ wide.T
                wide = torch.addmm(wide, torch.addmm(gram, gram, gram, beta=second, alpha=third),
                                   wide, beta=first)
            part.mul_(1 - group["lr"] * group["weight_decay"])
            part.add_(wide.T if tall else wide,
                      alpha=-0.2 * group["lr"] * math.sqrt(max(wide.shape)))
        return None


class Optimizer:
    """Muon (Jordan et al. 2024) with steps of AdamW's size (Liu et al. 2025) for weights from
    features to features, convolutions as matrices (outputs, inputs times width); AdamW (Loshchilov
    and Hutter 2019) for norms, biases, inputs without features and outputs.
    """

    def __init__(self, network: Network, *, weight_decay: float) -> None:
        self.hidden = network.hidden_weights()
        # Views: a step on them is one on the network's weights.
        self.matrices = [torch.nn.Parameter(one.detach().flatten(1)) for one in self.hidden]
        expected, posterior = network.separate_parts()
        hidden = {id(one) for one in self.hidden}
        groups: list[dict[str, Any]] = [
            {"params": [one for one in posterior if id(one) not in hidden]},
            {"params": expected, "weight_decay": _DECAY_OF_EXPECTED}]
        self.parts: list[torch.optim.Optimizer] = [
            torch.optim.AdamW(groups, weight_decay=weight_decay),
            _Muon(self.matrices, weight_decay=weight_decay, adjust_lr_fn="match_rms_adamw")]

    @property
    def rate(self) -> float:
        """Learning rate of the last step."""
        return self.parts[0].param_groups[0]["lr"]

    def step(self, rate: float) -> None:
        """A step at a learning ``rate`` along the gradients, which are then cleared."""
        for matrix, weight in zip(self.matrices, self.hidden, strict=True):
            matrix.grad = weight.grad.flatten(1) if weight.grad is not None else None
            weight.grad = None
        for part in self.parts:
            for group in part.param_groups:
                group["lr"] = rate
            part.step()
            part.zero_grad()

    def state_dict(self) -> dict[str, Any]:
        """Moments and settings of both parts, for :func:`torch.save`."""
        return {"parts": [part.state_dict() for part in self.parts]}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over those of :meth:`state_dict`."""
        for part, content in zip(self.parts, state["parts"], strict=True):
            part.load_state_dict(content)
