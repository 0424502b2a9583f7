"""What keeps the rows of two headers from being rows of one store."""

from skyline.errors import StoreMismatchError
from skyline.geodesy import Frame
from skyline.store.header import StoreHeader


def refuse_mismatch(
    one: tuple[StoreHeader, str], other: tuple[StoreHeader, str], what: str, advice: str
) -> None:
    """Raise `StoreMismatchError` where rows of two headers do not belong into one store.

    With each header comes where it is, for a message that begins with ``what``.
    """
    said = [
        f"{name} is {was!r} {one[1]}, {now!r} {other[1]}"
        for name, was, now in _differences(one[0], other[0])
    ]
    if said:
        raise StoreMismatchError(f"{what}: {'; '.join(said)}; {advice}")


def _differences(one: StoreHeader, other: StoreHeader) -> list[tuple[str, object, object]]:
    """Return what differs, by name and with both values; the files' places and makers may."""
    if one.holds != other.holds:
        return [("what it holds", one.holds, other.holds)]
    found: list[tuple[str, object, object]] = []
    if one.frame_wkt != other.frame_wkt:
        names = _frame_name(one.frame_wkt), _frame_name(other.frame_wkt)
        pair = names if names[0] != names[1] else (one.frame_wkt, other.frame_wkt)
        found.append(("frame", *pair))
    for name in ("dem_digest", "width", "max_keypoints", "rows"):
        found.append((name, getattr(one, name), getattr(other, name)))
    if one.coding and other.coding:
        found.append(("coding", one.coding, other.coding))
    for key in sorted({*one.config, *other.config}):
        was, now = one.config.get(key, "absent"), other.config.get(key, "absent")
        found.append((f"config {key}", was, now))
    return [(name, was, now) for name, was, now in found if was != now]


def _frame_name(wkt: str) -> str:
    try:
        return Frame(wkt).name
    except RuntimeError:  # pyproj's CRSError: the text may come from anywhere
        return wkt
