"""A benchmark that is run once for all tests of a module."""

import io
import json
from contextlib import redirect_stdout

import pytest

import skyline_bench.cli


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Return a function that runs ``skyline-bench ARGS...``, and gives its record and output."""

    def run_command(*arguments):
        path = tmp_path_factory.mktemp("record") / "record.json"
        printed = io.StringIO()
        with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed):
            patch.setattr("sys.argv", ["skyline-bench", *map(str, arguments), "--json", str(path)])
            with pytest.raises(SystemExit) as stop:
                skyline_bench.cli.main()
        assert not stop.value.code
        return json.loads(path.read_text()), printed.getvalue()

    return run_command
