"""Things in front of drawn mountains: trees, people, packs, wires, houses, windows."""

import cv2
import numpy as np

from skyline.arrays import Float32Array, UInt8Array
from skyline_training.landscapes import Drawing, fractal


def put_in_front(drawing: Drawing) -> None:
    """Put things in front of the ridge."""
    rng = drawing.rng
    for chance, most, put in (
        (0.28, 9, _conifer),
        (0.12, 1, _foliage),
        (0.14, 4, _figure),
        (0.08, 3, _bulk),
        (0.1, 4, _lines),
        (0.07, 1, _houses),
        (0.08, 1, _window),
    ):
        if rng.random() < chance:
            for _ in range(rng.integers(1, most) if most > 1 else 1):
                put(drawing)


def dark(rng: np.random.Generator, high: float = 75.0) -> Float32Array:
    """Return a dark colour."""
    grey = rng.uniform(3.0, high)
    return np.asarray(np.clip(grey + rng.normal(0, 8, 3), 0, 255), dtype=np.float32)


def _grain(rng: np.random.Generator, shape: tuple[int, ...], share: float) -> Float32Array:
    return np.asarray(1.0 + share * fractal(rng, (shape[0], shape[1]), 0.5), np.float32)[
        ..., np.newaxis
    ]


def _conifer(drawing: Drawing) -> None:
    rng, (height, width) = drawing.rng, drawing.size
    centre = (
        rng.uniform(0, 1) if rng.random() < 0.5 else abs(rng.choice([0, 1]) - rng.exponential(0.1))
    )
    top, half = rng.uniform(-0.1, 0.7) * height, np.exp(rng.uniform(-4.2, -2.2)) * width
    tall = half * rng.uniform(3.0, 8.0)
    rows, columns = np.mgrid[0:height, 0:width].astype(np.float32)
    reach = half * np.clip((rows - top) / tall, 0, 1) ** rng.uniform(0.6, 1.0) + (rows > top)
    whorls = 0.4 * np.sin((rows - top) / tall * rng.uniform(25, 80))
    ragged = 1.0 + whorls + 0.45 * fractal(rng, (height, width), rng.uniform(0.3, 0.8))
    opacity = np.clip(reach * ragged - np.abs(columns - centre * width), 0, 1) * (rows > top)
    colour = dark(rng) * _grain(rng, (height, width), 0.3) * np.array([0.95, 1.1, 0.85])
    drawing.cover(opacity, colour)


def _foliage(drawing: Drawing) -> None:
    """Leaves or twigs that hang in from a side."""
    rng, (height, width) = drawing.rng, drawing.size
    column, row = rng.choice([0.0, 1.0, rng.random()]) * width, rng.uniform(-0.1, 1.1) * height
    across = (np.arange(width) - column) / (rng.uniform(0.08, 0.3) * width)
    down = (np.arange(height)[:, np.newaxis] - row) / (rng.uniform(0.08, 0.35) * height)
    density = (
        1.0 - np.hypot(across, down) + 0.6 * fractal(rng, (height, width), rng.uniform(0.5, 1.3))
    )
    opacity = np.clip(density / 0.15, 0, 1).astype(np.float32)
    colour = dark(rng, 110.0) * _grain(rng, (height, width), 0.4) * np.array([1.0, 1.15, 0.7])
    drawing.cover(opacity, colour)


def _figure(drawing: Drawing) -> None:
    """Draw a person, seen from behind.

    A person has shoulders and legs or a hem, an arm, a head, a hat, a pack.
    """
    rng, (height, width) = drawing.rng, drawing.size
    close = rng.random() < 0.3
    size = np.exp(rng.uniform(-2.4, -1.2) if close else rng.uniform(-4.5, -2.2)) * height
    at = int(rng.uniform(0.03, 0.97) * (width - 1))
    ridge = drawing.row[at] if np.isfinite(drawing.row[at]) else 0.4 * height
    top = ridge + rng.uniform(-4.0 if close else -7.0, 2.0) * size
    broad = rng.uniform(1.3, 2.2) * size
    foot = top + rng.uniform(6.0, 16.0) * size
    right = [(0.5, 1.8), (1.0, 2.6), (1.1, 6.0), (0.8, 99.0)]
    body = [*right, *((-x, y) for x, y in reversed(right))]
    points = [(at + x * broad, min(top + y * size, foot)) for x, y in body]
    coat = np.zeros((height, width), np.uint8)
    cv2.fillPoly(coat, [np.array(points, np.int32)], 255)
    if rng.random() < 0.3:
        hand = (int(at + rng.uniform(-5, 5) * size), int(top + rng.uniform(-2, 4) * size))
        cv2.line(coat, (at, int(top + 2.6 * size)), hand, 255, max(1, int(0.6 * size)))
    _paint_cloth(drawing, coat)
    rounds = [(1.0, 0.7, 1.0, 1.0), (4.3, broad / size * 0.9, 2.3, 0.4), (0.6, 1.5, 0.35, 0.3)]
    for down, half, tall, chance in rounds:  # The head, a pack, the brim of a hat.
        if rng.random() < chance:
            part = np.zeros((height, width), np.uint8)
            axes = max(1, int(half * size)), max(1, int(tall * size))
            cv2.ellipse(part, (at, int(top + down * size)), axes, 0, 0, 360, 255, -1)
            _paint_cloth(drawing, part)


def _paint_cloth(drawing: Drawing, mask: UInt8Array) -> None:
    """Paint a mask (H, W) in one bright or dark colour."""
    rng = drawing.rng
    colour = rng.uniform(5, 235, 3) * rng.uniform(0.1, 1.0) * _grain(rng, mask.shape, 0.12)
    drawing.cover(cv2.blur(mask, (2, 2)).astype(np.float32) / 255.0, colour)


def _bulk(drawing: Drawing) -> None:
    """Draw a pack, a boulder or a hand close by.

    It is out of focus, and reaches in from below or from a side.
    """
    rng, (height, width) = drawing.rng, drawing.size
    column = rng.choice([0.0, 1.0, rng.random()]) * width
    row = (1.0 if 0.0 < column < width else rng.uniform(0.3, 1.0)) * height
    half, tall = rng.uniform(0.05, 0.25) * width, rng.uniform(0.2, 0.8) * height
    power = rng.uniform(1.8, 5.0)
    across = np.abs(np.arange(width) - column) / half
    down = np.abs(np.arange(height)[:, np.newaxis] - row) / tall
    inside = 1.0 - (across**power + down**power) ** (1.0 / power)
    rough = rng.uniform(0.0, 0.15) * fractal(rng, (height, width), 2.0)
    opacity = np.clip((inside + rough) / rng.uniform(0.01, 0.08), 0, 1)
    if rng.random() < 0.3:  # A finger, or a strap.
        finger = np.zeros((height, width), np.uint8)
        start = int(column), int(row - 0.9 * tall)
        end = int(column + rng.normal(0.0, 0.15) * width), int(row - rng.uniform(1.0, 1.5) * tall)
        cv2.line(finger, start, end, 255, max(2, int(rng.uniform(0.02, 0.06) * height)))
        opacity = np.maximum(opacity, cv2.blur(finger, (3, 3)) / 255.0)
    shade = 1.0 + 0.3 * fractal(rng, (height, width), 1.7)[..., np.newaxis]
    colour = rng.uniform(5, 235, 3) * rng.uniform(0.1, 1.0) * np.maximum(shade, 0.1)
    drawing.cover(opacity, np.clip(colour, 0, 255))


def _lines(drawing: Drawing) -> None:
    """A pole, or a wire that sags."""
    rng, (height, width) = drawing.rng, drawing.size
    mask = np.zeros((height, width), np.uint8)
    if rng.random() < 0.5:
        at, top = int(rng.uniform(0, width)), int(rng.uniform(-0.1, 0.6) * height)
        lean = int(rng.normal(0, 0.02) * width)
        cv2.line(mask, (at, top), (at + lean, height), 255, int(rng.integers(1, 9)), cv2.LINE_AA)
        for arm in range(rng.integers(0, 3)):
            half = int(rng.uniform(0.01, 0.05) * width)
            cv2.line(mask, (at - half, top + 8 + 9 * arm), (at + half, top + 8 + 9 * arm), 255, 2)
    else:
        x = np.linspace(-1, 1, 40)
        sag = (rng.uniform(0.0, 0.6) + 0.06 * x**2 + rng.uniform(-0.3, 0.3) * x) * height
        points = np.stack([(x + 1) / 2 * width, sag], axis=1).astype(np.int32)
        cv2.polylines(mask, [points], False, int(rng.integers(120, 256)), 1, cv2.LINE_AA)
    drawing.cover(mask.astype(np.float32) / 255.0, dark(rng, 140.0))


def _houses(drawing: Drawing) -> None:
    rng, (height, width) = drawing.rng, drawing.size
    for _ in range(rng.integers(1, 6)):
        wide, tall = (rng.uniform(0.04, 0.3, 2) * (width, height)).astype(int)
        left, top = int(rng.uniform(-0.1, 1.0) * width), int(rng.uniform(0.2, 0.85) * height)
        mask = np.zeros((height, width), np.uint8)
        roof = int(rng.choice([0.0, 0.5]) * tall)
        right, ridge = left + wide, (left + wide // 2, top - roof)
        corners = [(left, top), ridge, (right, top), (right, height), (left, height)]
        cv2.fillPoly(mask, [np.array(corners, np.int32)], 255)
        colour = np.full((height, width, 3), rng.uniform(30, 230, 3), np.float32)
        step = max(6, wide // int(rng.integers(3, 8)))
        panes = rng.uniform(10, 250, 3)
        for y in range(top + step, min(height, top + max(tall, step)), 2 * step):
            for x in range(left + step // 2, left + wide - step // 2, step):
                cv2.rectangle(colour, (x, y), (x + step // 2, y + step), panes.tolist(), -1)
        drawing.cover(mask.astype(np.float32) / 255.0, colour)


def _window(drawing: Drawing) -> None:
    """Draw the frame of a car's window, a door or a tent.

    It is dark all round the opening.
    """
    rng, (height, width) = drawing.rng, drawing.size
    mask = np.full((height, width), 255, np.uint8)
    reach = rng.uniform(-0.12, 0.25, 4)
    left, top, right, bottom = reach * (width, height, width, height)
    right, bottom = width - right, height - bottom
    jitter = rng.uniform(-0.08, 0.08, (4, 2)) * (width, height)
    corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    cv2.fillPoly(mask, [(corners + jitter).astype(np.int32)], 0)
    round_px = 2 * int(rng.uniform(0.0, 0.06) * width) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (round_px, round_px))
    mask = np.asarray(255 - cv2.morphologyEx(255 - mask, cv2.MORPH_OPEN, disc), dtype=np.uint8)
    if rng.random() < 0.5:
        centre = (int(rng.uniform(0, 1) * width), int(rng.uniform(0.5, 1.0) * height))
        axes = (int(rng.uniform(0.05, 0.2) * width), int(rng.uniform(0.05, 0.2) * height))
        cv2.ellipse(mask, centre, axes, rng.uniform(-20, 20), 0, 360, 255, -1)
    opacity = cv2.blur(mask, (3, 3)).astype(np.float32) / 255.0
    shade = 1.0 + 0.5 * fractal(rng, (height, width), 2.0)[..., np.newaxis]
    colour = np.clip(dark(rng, 60.0) * np.maximum(shade, 0.0), 0, 255)
    drawing.cover(opacity, colour)
