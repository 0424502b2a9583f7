"""Sessions of the page: their files, how long they are kept, and their matches."""

from contextlib import closing
from types import SimpleNamespace

import pytest

from skyline.web.area import shown_name
from skyline.web.sessions import GoneError, Sessions, Stay


@pytest.fixture
def sessions():
    made = Sessions()
    yield made
    made.close()


def photo_in(session):
    path = session.path_for("photo.jpg")
    path.write_bytes(bytes(100))
    assert session.bytes == 100
    session.photos["id"] = SimpleNamespace(id="id", path=path, cancel=lambda: None)


def test_files_lie_below_the_servers_own_folder_under_names_of_its_own(sessions):
    session = sessions.begin()
    for name in ("../../etc/passwd", "/etc/passwd", "a\\..\\b.jpg", "x.j/pg", "no\0name.jpg", ""):
        path = session.path_for(shown_name(name))
        assert path.parent == session.folder
        assert path.stem.isalnum()
    assert shown_name("../../etc/passwd") == "passwd"
    assert shown_name("C:\\photos\\Horn.jpg") == "Horn.jpg"
    assert shown_name("") == "photo"


def test_a_session_is_kept_for_a_while_after_its_page_is_closed(sessions):
    session = sessions.begin()
    photo_in(session)
    sessions.sweep()
    assert session.folder.exists()


def test_a_session_ends_when_its_page_has_been_closed_for_long():
    with closing(Sessions(Stay(gone_s=0.0))) as sessions:
        gone = sessions.begin()
        there = sessions.begin()
        photo_in(gone)
        there.pages += 1
        sessions.sweep()
        assert not gone.folder.exists()
        assert there.folder.exists()
        with pytest.raises(GoneError):
            sessions.of(gone.id)
        there.page_closed()
        sessions.sweep()
        assert not there.folder.exists()


def test_all_files_go_with_the_server(sessions):
    session = sessions.begin()
    photo_in(session)
    sessions.close()
    assert not session.folder.parent.exists()
