"""What tests of the command line share."""


def csv_of(path, rows, header="easting,northing"):
    path.write_text("\n".join([header, *rows]) + "\n")
    return path


def assert_refused(done, message):
    assert done.code == 2, done
    assert message in done.err
    assert done.err.startswith("error: ")
    assert done.err.count("\n") == 1
    assert done.out == ""
