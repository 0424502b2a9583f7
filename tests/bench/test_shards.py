"""Shards: workers find what one process finds."""


def test_workers_find_the_same_even_if_one_is_killed(recorded, dem, tmp_path):
    small = "--quick", "--places", "1200", "--km2", "1"
    record, _ = recorded("shards", dem, *small, "--folder", tmp_path)
    rows = {row["process"]: row for row in record["rows"]}
    assert list(rows) == ["one", "asking", "worker 1", "worker 2", "asking, a worker killed"]
    assert rows["asking"]["equal"]
    assert rows["asking, a worker killed"]["equal"]
    assert rows["worker 1"]["bytes"] == rows["one"]["bytes"] / 2
