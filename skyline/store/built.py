"""How much of a build its store holds, which every command says of a store that is not finished."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Built:
    """The parts of a build that a store holds, whatever its builder counts them in.

    Places and renderings are counted by viewpoints or by blocks of the map; a build that goes by
    coverage, by thousandths of it. The store of a tile holds some of the whole build's parts.
    """

    done: int = 0
    total: int = 0
    """0 where the store does not know: rows that no build wrote, or an older Skyline did."""

    @property
    def share(self) -> float | None:
        """The share of the build that is done, 0 to 1; None where the store does not know."""
        return self.done / self.total if self.total else None

    @property
    def finished(self) -> bool | None:
        """Whether the build was finished; None where the store does not know."""
        return self.done == self.total if self.total else None

    @property
    def note(self) -> str:
        """One line about a build that was not finished, or may not have been; empty otherwise."""
        if self.finished:
            return ""
        if self.share is None:
            return "it is not known whether its build was finished"
        percent = 100 * self.done // self.total
        some = f"{percent} %" if percent or not self.done else "less than 1 %"
        return f"its build is not finished: {some} of the area is there"


def joined(parts: list[Built], *, overlap: bool) -> Built:
    """Return how much of their build stores hold together, at least.

    Where they ``overlap``, or one does not know, that is as much as the one that holds most.
    """
    total = max(part.total for part in parts)
    done = [part.done for part in parts if part.total == total]
    apart = len(done) == len(parts) and not overlap
    return Built(min(sum(done) if apart else max(done), total), total)
