"""Any text in any field is a number or refused in words; any request is a friend's or refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from servogym.envs.panel.entry import number
from servogym.envs.panel.guard import Guard, Owner
from servogym.envs.panel.server import kept_token

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


def judge(headers, query="", token="secret"):
    return Guard(None, Owner(token), "servogym_panel_8402").judge(headers, query)[:2]


KNOWN = {"cookie": "servogym_panel_8402=secret"}


@pytest.mark.parametrize("host", ["127.0.0.1:8402", "localhost:9", "[::1]:8402", "labpc", "a.b"])
def test_who_knows_the_token_is_served_by_whatever_name(host):
    assert judge({"host": host}, "token=secret") == ("", "secret")
    assert judge({"host": host, "origin": f"http://{host}"} | KNOWN) == ("", "")


@pytest.mark.parametrize("query", ["", "token=", "token=other", "token=secre", "token=secret%00"])
@pytest.mark.parametrize("cookie", ["", "servogym_panel_8402=other", "servogym_panel=secret", "\0"])
def test_who_does_not_know_the_token_is_refused_on_the_loopback_too(query, cookie):
    assert "token" in judge({"host": "127.0.0.1:8402", "cookie": cookie}, query)[0]


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://localhost:9", ""])
def test_a_strangers_origin_is_refused_although_the_browser_has_the_cookie(origin):
    assert "stranger" in judge({"host": "localhost:8402", "origin": origin} | KNOWN)[0]


def test_the_token_stays_the_same_and_is_this_users_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    token = kept_token()
    assert kept_token() == token
    (path,) = tmp_path.rglob("token")
    assert path.stat().st_mode & 0o777 == 0o600
    path.chmod(0o644)  # somebody else may have read it
    assert kept_token() != token
    monkeypatch.setenv("XDG_CONFIG_HOME", "/proc/no")
    assert kept_token() != kept_token()


@pytest.mark.parametrize(
    ("options", "said"),
    [("--mjcf robot.xml --joint elbow --axis gantry", "two machines"),
     ("--node-id 5 --axis gantry", "--axis is for a machine"),
     ("--samples 3", "give --node-id"), ("--samples 0", "--samples: 0 is out of range above 0"),
     ("-i virtual", "give --node-id"),
     ("-i virtual -c here --node-id 5 --samples 1e6", "samples/s"),
     ("--listen", "give --node-id"), ("--joint elbow", "--mjcf")],
)
def test_an_option_that_would_do_nothing_is_refused(options, said, refused):
    assert said in refused(["panel", "--no-browser", "--port", "18991", *options.split()])
