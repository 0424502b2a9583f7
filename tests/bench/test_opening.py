"""What one answer takes in a new process: which runs are timed, and in which order."""


def test_every_command_is_timed_the_first_time_and_again(recorded, dem):
    record, printed = recorded("opening", dem, "--quick")
    runs = [(row["command"], row["run"]) for row in record["rows"]]
    commands = ("horizon", "orient", "match")
    assert runs == [(command, run) for command in commands for run in ("first", "next")]
    assert all(row["seconds"] > 0.0 and row["cpu_seconds"] > 0.0 for row in record["rows"])
    assert all(command in printed for command in commands)
