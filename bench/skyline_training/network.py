"""Train the network that finds each column's skyline, and write it as Skyline reads it.

An encoder goes down to a thirty-second of the size, and a decoder back up to half of it. Each of
these pixels gets four numbers: the log-odds that the column's skyline runs there, relative to a
column without a skyline (0), and scores of sky, ground and cover, which only training uses.
"""

import gzip
import io
import logging
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval

from skyline.arrays import Float32Array, Progress, UInt8Array
from skyline.files import write_whole
from skyline.photo.extract import levelled
from skyline_training.landscapes import UNKNOWN, TrainingPhoto

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


log = logging.getLogger(__name__)

_SHAPES = ((256, 256), (192, 256), (256, 192), (128, 384), (160, 512))
"""Heights and widths of batches: square, both ways up, panoramas'."""
_SHAPE_SHARES = (0.32, 0.32, 0.18, 0.08, 0.1)
_WIDE = 2.0
"""Aspect of a panorama; half of the photographs in batches of panoramas' shapes are panoramas."""
_BATCH = 16
_LEARNING_RATE, _TUNING_RATE = 4e-3, 1.5e-3
"""Greatest rates from random weights, and from those of a model."""
_NORMALIZED_ON = 6
"""Batches over which the features of a model that was read are normalized again."""
_WEIGHT_DECAY = 1e-3
_WARM_UP_STEPS = 100
_AVERAGE = 0.99
"""Share of the averaged weights that is kept at each step."""
_SEGMENTATION_WEIGHT = 0.5
_SPREAD_PX = 0.6
"""Deviation over which a true row is spread, pixels of the scores."""
_LAST_STEPS = 100


def train(
    photos: Sequence[TrainingPhoto],
    steps: int,
    seed: int,
    progress: Progress,
    start: Path | None = None,
) -> SkyNet:
    """Train on photographs, from a written model if one is given; return averaged weights.

    One thread: a small network's threads wait for one another longer than they work.
    """
    torch.manual_seed(seed)
    torch.set_num_threads(1)
    rng = np.random.default_rng(seed)
    net, average = SkyNet(), SkyNet()
    if start is not None:
        _read_model(net, start)
        pictures = [_batch(photos, rng, _SHAPES[1])[0] for _ in range(_NORMALIZED_ON)]
        _normalize(net, torch.cat(pictures))
    for each in (net, average):
        each.to(memory_format=torch.channels_last)
    average.load_state_dict(net.state_dict())
    greatest = _LEARNING_RATE if start is None else _TUNING_RATE
    optimizer = torch.optim.AdamW(net.parameters(), greatest, weight_decay=_WEIGHT_DECAY)
    losses = []
    for step in range(steps):
        rate = 0.5 * (1.0 + np.cos(np.pi * step / steps)) * min(1.0, (step + 1) / _WARM_UP_STEPS)
        optimizer.param_groups[0]["lr"] = greatest * rate
        shape = _SHAPES[rng.choice(len(_SHAPES), p=_SHAPE_SHARES)]
        losses.append(_step(net, optimizer, _batch(photos, rng, shape)))
        _follow(average, net, min(_AVERAGE, step / (step + 10)))
        progress(step + 1, steps)
    mean = np.mean(losses[-_LAST_STEPS:], axis=0)
    log.warning("losses of the last steps: skyline %.3f, labels %.3f", *mean)
    average.eval()
    return average


def _weights_of(path: Path) -> dict[str, Tensor]:
    """Return the weights of a written model by their names."""
    import onnx  # noqa: PLC0415  (needed to start from a model only)

    model = onnx.load_model_from_string(gzip.decompress(path.read_bytes()))
    read = onnx.numpy_helper.to_array
    return {one.name: torch.tensor(read(one)) for one in model.graph.initializer}


def _read_model(net: SkyNet, path: Path) -> None:
    """Give a network the weights of a written model; it then computes the same."""
    net.eval()
    state = net.state_dict()
    for name, weights in _weights_of(path).items():
        part, _, kind = name.rpartition(".")
        if name not in state:  # A convolution's, that was its normalization's.
            parent, _, index = part.rpartition(".")
            part = f"{parent}.{int(index) + 1}"
        state[f"{part}.{kind}"].copy_(weights)


def _normalize(net: SkyNet, pictures: Tensor) -> None:
    """Normalize features over pictures, as in training, where a written model does not."""
    seen = list[tuple[nn.BatchNorm2d, Tensor, Tensor]]()

    def see(norm: nn.Module, inputs: tuple[Tensor, ...], _: Tensor) -> None:
        assert isinstance(norm, nn.BatchNorm2d)
        seen.append((norm, *torch.var_mean(inputs[0], (0, 2, 3), correction=0)))

    norms = [part for part in net.modules() if isinstance(part, nn.BatchNorm2d)]
    hooks = [norm.register_forward_hook(see) for norm in norms]
    with torch.no_grad():
        net(pictures)
        for norm, variance, mean in seen:
            for kept, value in ((norm.running_mean, mean), (norm.running_var, variance)):
                assert kept is not None
                kept.copy_(value)
            norm.weight.copy_((variance + norm.eps).sqrt())
            norm.bias.add_(mean)
    for hook in hooks:
        hook.remove()


def _batch(
    photos: Sequence[TrainingPhoto], rng: np.random.Generator, shape: tuple[int, int]
) -> tuple[Tensor, ...]:
    """Return pictures (N, 4, H, W), labels (N, H, W) and rows (N, W), changed at random."""
    some = [photos[int(i)] for i in rng.integers(0, len(photos), _BATCH)]
    wide = [one for one in photos if one.label.shape[1] > _WIDE * one.label.shape[0]]
    if shape[1] > _WIDE * shape[0] and wide:
        half = _BATCH // 2
        some[:half] = [wide[int(i)] for i in rng.integers(0, len(wide), half)]
    cuts = [_cut(one, shape, rng) for one in some]
    image, label, row = (np.stack(parts) for parts in zip(*cuts, strict=True))
    light = torch.from_numpy(image.transpose(0, 3, 1, 2).copy())
    down = torch.linspace(-1, 1, shape[0]).view(1, 1, -1, 1).expand(_BATCH, 1, *shape)
    picture = torch.cat([light, down], 1).contiguous(memory_format=torch.channels_last)
    return picture, torch.from_numpy(label[:, ::2, ::2].copy()).long(), torch.from_numpy(row)


def _cut(
    photo: TrainingPhoto, shape: tuple[int, int], rng: np.random.Generator
) -> tuple[Float32Array, UInt8Array, Float32Array]:
    """Return a rectangle of a photograph at another size, mirrored half of the times."""
    height, width = photo.label.shape
    share = rng.uniform(0.7, 1.0)
    aspect = shape[1] / shape[0] * np.exp(rng.uniform(-0.35, 0.35))
    w = int(min(width, share * height * aspect))
    h = int(min(height, w / aspect))
    top, left = int(rng.integers(0, height - h + 1)), int(rng.integers(0, width - w + 1))
    window = slice(top, top + h), slice(left, left + w)
    image = cv2.resize(
        cv2.LUT(photo.image[window], _tones(rng)), shape[::-1], interpolation=cv2.INTER_AREA
    )
    label = cv2.resize(photo.label[window], shape[::-1], interpolation=cv2.INTER_NEAREST)
    across = ((np.arange(shape[1] // 2) + 0.5) * 2.0 * w / shape[1] + left).astype(np.intp)
    row = (photo.row_px[across] - top) * np.float32(shape[0] / h)
    if rng.random() < 0.5:
        image, label, row = image[:, ::-1], label[:, ::-1], row[::-1]
    return (
        levelled(np.asarray(image, dtype=np.uint8)),
        np.asarray(label, dtype=np.uint8),
        np.asarray(row, dtype=np.float32),
    )


def _tones(rng: np.random.Generator) -> UInt8Array:
    """Return a table (1, 256, 3) that changes exposure, contrast and tone."""
    level = np.linspace(0.0, 1.0, 256)[:, np.newaxis] ** np.exp(rng.normal(0.0, 0.25))
    gain = np.exp(rng.normal(0.0, 0.15) + rng.normal(0.0, 0.05, 3))
    toned = 255.0 * (gain * level + rng.normal(0.0, 0.03))
    return np.asarray(np.clip(np.rint(toned), 0, 255)[np.newaxis], dtype=np.uint8)


def _step(
    net: SkyNet, optimizer: torch.optim.Optimizer, batch: tuple[Tensor, ...]
) -> tuple[float, float]:
    """Take one step; return the losses of the skyline and of the labels."""
    picture, label, row = batch
    net.train()
    optimizer.zero_grad(set_to_none=True)
    with torch.autocast("cpu", torch.bfloat16):
        scores = net(picture)
    scores = scores.float()
    skyline = _skyline_loss(scores[:, 0], row / 2.0)
    labels = functional.cross_entropy(scores[:, 1:], label, ignore_index=UNKNOWN)
    (skyline + _SEGMENTATION_WEIGHT * labels).backward()
    nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimizer.step()
    return float(skyline.detach()), float(labels.detach())


def _skyline_loss(odds: Tensor, row: Tensor) -> Tensor:
    """Return the mean negative log-probability of each column's row, or of its having none.

    ``odds`` (N, H, W) are log-odds against none; ``row`` is (N, W), NaN for none.
    """
    log_share = torch.log_softmax(torch.cat([odds, torch.zeros_like(odds[:, :1])], 1), 1)
    seen = torch.isfinite(row) & (row > 0.5) & (row < odds.shape[1] - 0.5)
    # A border at row r is r - 0.5 in pixel centres.
    centre = torch.where(seen, row, 0.0)[:, None] - 0.5
    away = torch.arange(odds.shape[1]).view(1, -1, 1) - centre
    weight = torch.softmax(-0.5 * (away / _SPREAD_PX) ** 2, 1)
    found = -(weight * log_share[:, :-1]).sum(1)
    return torch.where(seen, found, -log_share[:, -1]).mean()


def _follow(average: SkyNet, net: SkyNet, kept: float) -> None:
    with torch.no_grad():
        for mean, now in zip(average.state_dict().values(), net.state_dict().values(), strict=True):
            if mean.is_floating_point():
                mean.mul_(kept).add_(now, alpha=1.0 - kept)


def _fused(net: nn.Module) -> nn.Module:
    """Fold what normalizes a convolution's output into its weights, throughout."""
    for name, part in list(net.named_children()):
        setattr(net, name, _fused(part))
    parts = list(net.named_children())
    for (name, one), (other, following) in pairwise(parts):
        if isinstance(one, nn.Conv2d) and isinstance(following, nn.BatchNorm2d):
            setattr(net, name, fuse_conv_bn_eval(one, following))
            setattr(net, other, nn.Identity())
    return net


def write_model(net: SkyNet, path: Path, start: Path | None = None) -> None:
    """Write a network as zipped ONNX, its weights to half precision.

    A network that began from a written model is written halfway from that: it keeps more of what
    the model knew (Wortsman et al. 2022, robust fine-tuning). The file states one size of pictures;
    OpenCV runs it at any.
    """
    net = _fused(net.eval()).to(memory_format=torch.contiguous_format)
    with torch.no_grad():
        before = {} if start is None else _weights_of(start)
        for name, weight in net.named_parameters():
            weight.copy_(((weight + before.get(name, weight)) / 2.0).half().float())
    whole = io.BytesIO()
    torch.onnx.export(
        net,
        (torch.zeros(1, INPUTS, 256, 256),),
        whole,
        input_names=["picture"],
        output_names=["scores"],
        opset_version=13,
        dynamo=False,
    )
    write_whole(path, gzip.compress(whole.getvalue(), 9, mtime=0))
