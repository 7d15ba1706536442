"""Any text in any field is a number or refused in words; any request is a friend's or refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servogym.envs.panel.entry import number
from servogym.envs.panel.guard import Guard

TYPED = "0123456789.,-+−eExXhHnNaifF %'\"<>;/\\\n\0µ²²Ⅷ٣" + "🙂"


@given(st.text(TYPED, max_size=60), st.booleans())
def test_any_text_is_a_number_in_the_range_or_refused_in_words(text, whole):
    words, value = "", 0.0
    try:
        value = number(text, -10, 1000, "mm", whole=whole)
    except ValueError as error:
        words = str(error)
    assert -10 <= value <= 1000
    assert not words or 5 < len(words) < 160


@pytest.mark.parametrize(
    ("text", "value"),
    [("1,5", 1.5), ("−3", -3), (" 7 ", 7), ("1e2", 100), ("0x1F", 31), ("1Fh", 31)],
)
def test_a_number_may_be_written_as_people_write_it(text, value):
    assert number(text, -100, 1000, whole="." not in text and "," not in text) == value


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "1e999", "", "drop table", "9" * 400])
def test_what_is_no_number_is_said_so(text):
    with pytest.raises(ValueError, match=r"number|range"):
        number(text, -1, 1, "V")


def judge(headers, served="127.0.0.1", token="", query=""):
    return Guard(None, served, 8402, token).judge(headers, query)


@pytest.mark.parametrize("host", ["127.0.0.1:8402", "localhost:8402", "[::1]:8402"])
def test_the_loopback_is_served(host):
    assert judge({"host": host}) == ("", False)
    assert judge({"host": host, "origin": f"http://{host}"}) == ("", False)


@pytest.mark.parametrize(
    "host",
    ["evil.example:8402", "127.0.0.1:80", "127.0.0.1", "", "192.168.1.5:8402", "[::1", "a:b"],
)
def test_a_strangers_host_is_refused(host):
    assert "not served" in judge({"host": host})[0]


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:9", ""])
def test_a_strangers_origin_is_refused(origin):
    assert "stranger" in judge({"host": "localhost:8402", "origin": origin})[0]


def test_beyond_the_loopback_the_token_has_to_be_known():
    here = {"host": "192.168.1.5:8402"}
    assert "token" in judge(here, "0.0.0.0", "secret")[0]
    assert "token" in judge(here, "0.0.0.0", "secret", "token=other")[0]
    assert judge(here, "0.0.0.0", "secret", "token=secret") == ("", True)
    cookie = here | {"cookie": "servogym_panel=secret"}
    assert judge(cookie, "0.0.0.0", "secret") == ("", False)
    assert "not served" in judge({"host": "evil.example:8402"}, "0.0.0.0", "secret")[0]
