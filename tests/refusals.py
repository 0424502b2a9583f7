"""What a refusal says, for the tests of messages."""

import pytest

from skyline.errors import InputError


def assert_says(said, call, error=InputError):
    """Require that a call is refused in one line that has a text, a regular expression."""
    with pytest.raises(error, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)
