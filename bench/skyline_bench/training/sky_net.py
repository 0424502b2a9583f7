"""The network that tells where each column's skyline lies.

An encoder down to a thirty-second of the size and a decoder back up to half of it. Of each of
these pixels it gives four numbers: the log-odds that the column's skyline runs there, against the
column showing none (0); and scores of sky, ground and cover, which only training asks for.
"""

import torch
from torch import Tensor, nn

INPUTS = 4
"""Red, green and blue from -1 to 1, and the row from -1 at the top to 1 at the bottom."""


def _conv(inputs: int, outputs: int, stride: int = 1, size: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, stride, size // 2, bias=False),
        nn.BatchNorm2d(outputs),
        nn.ReLU(),
    )


class _Block(nn.Module):
    """Inverted residual: wider, each channel by itself, narrower, added to what came in."""

    def __init__(self, channels: int, dilation: int = 1) -> None:
        super().__init__()
        wide = 2 * channels
        apart = nn.Conv2d(wide, wide, 5, 1, 2 * dilation, dilation, groups=wide, bias=False)
        self.body = nn.Sequential(
            _conv(channels, wide, size=1),
            apart,
            nn.BatchNorm2d(wide),
            nn.ReLU(),
            nn.Conv2d(wide, channels, 1, bias=False),
            nn.BatchNorm2d(channels),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Return what a block makes of features (N, C, H, W)."""
        return x + self.body(x)


class SkyNet(nn.Module):
    """Pictures (N, 4, H, W) to scores (N, 4, H/2, W/2); sides are multiples of 32."""

    def __init__(self) -> None:
        super().__init__()
        self.second = _conv(INPUTS, 16, 2)
        self.fourth = nn.Sequential(_conv(16, 24, 2), _conv(24, 24))
        self.eighth = nn.Sequential(_conv(24, 32, 2), _Block(32), _Block(32))
        self.sixteenth = nn.Sequential(_conv(32, 48, 2), _Block(48), _Block(48))
        self.deep = nn.Sequential(_conv(48, 64, 2), _Block(64), _Block(64, 2), _Block(64))
        self.to_sixteenth = nn.Sequential(_conv(64 + 48, 48, size=1), _Block(48))
        self.to_eighth = nn.Sequential(_conv(48 + 32, 32, size=1), _Block(32))
        self.to_fourth = nn.Sequential(_conv(32 + 24, 24, size=1), _conv(24, 24))
        self.to_second = _conv(24 + 16, 16, size=1)
        self.scores = nn.Conv2d(16, 4, 3, padding=1)
        self.up = nn.Upsample(scale_factor=2, mode="nearest")

    def forward(self, x: Tensor) -> Tensor:
        """Return scores; see the class."""
        second = self.second(x)
        fourth = self.fourth(second)
        eighth = self.eighth(fourth)
        sixteenth = self.sixteenth(eighth)
        y = self.up(self.deep(sixteenth))
        y = self.up(self.to_sixteenth(torch.cat([y, sixteenth], 1)))
        y = self.up(self.to_eighth(torch.cat([y, eighth], 1)))
        y = self.up(self.to_fourth(torch.cat([y, fourth], 1)))
        return self.scores(self.to_second(torch.cat([y, second], 1)))
