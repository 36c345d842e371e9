"""What an autoencoder that serves as prior shares with its training."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Architecture:
    """Widths of an autoencoder, and how long it is trained.

    Attributes:
        hidden: units of the encoder's layers; the decoder has them in reverse.
        latent: latent variables.
        steps: training steps.
        learning_rate: of Adam, at its highest.
    """

    hidden: tuple[int, ...]
    latent: int
    steps: int = 2000
    learning_rate: float = 2e-3


ARCHITECTURES = {
    "vae1": Architecture((2048, 1024, 512, 128), 64, steps=600, learning_rate=5e-4),
    "vae2": Architecture((512, 256, 128, 32), 32, steps=1500, learning_rate=1e-3),
    "vae3": Architecture((128, 32, 16), 8),
    "vae4": Architecture((32, 16, 8), 4),
}
"""VAE-1 to VAE-4 of Table 1."""

SIGMA_MIDDLE, SIGMA_REACH = -1.0, 1.5
"""The log of sigma is middle + reach * tanh(output), so that sigma, in deviations of the table,
lies between 0.08 and 1.65: no fabric is pinned, and no sample is thrown far out."""
