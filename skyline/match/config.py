"""The settings of a match."""

from dataclasses import dataclass

from skyline.arrays import refuse_text
from skyline.errors import InputError
from skyline.pose.pose_errors import ASSUMED


@dataclass(frozen=True, slots=True)
class MatchConfig:
    """Settings of a match.

    Attributes
    ----------
    refine : bool
        Whether the full matcher refines the retrieved poses by rendering.
    min_confidence : float
        The best place is the answer if it is right within 1 km with at least this probability,
        from 0 to 1. The answer is given within 200 m, rather than 1 km, if that leaves at most half
        of the allowed doubt: with the default, if it is right within 200 m with a probability of
        0.9. docs/accuracy.md says how many of such answers are right.
    fov_sd_share : float
        Standard deviation of a given field of view, as a share of it, 0 to 1.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    refine: bool = True
    min_confidence: float = 0.8
    fov_sd_share: float = ASSUMED.fov_sd_share

    def __post_init__(self) -> None:
        refuse_text(min_confidence=self.min_confidence, fov_sd_share=self.fov_sd_share)
        if not 0.0 <= self.min_confidence <= 1.0:
            raise InputError(
                f"least confidence is {self.min_confidence}; expected 0 (always answer) to 1"
            )
        if not 0.0 <= self.fov_sd_share < 1.0:
            raise InputError(f"fov_sd_share is {self.fov_sd_share}; expected a share from 0 to 1")
